"""The contract of a node's inputs: every cycle once, in order, whatever order the messages arrive in."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pkm_cnc.errors import MachineFault
from pkm_cnc.nodes.cycle_join import CycleJoin
from pkm_cnc.topics import topics

TABLE = topics(("u1", "u2", "u3"))
MONITOR = [TABLE[name] for name in ("tcp/setpoint", "u1/actual", "u2/actual", "u3/actual")]
DRIVE = [TABLE[name] for name in ("u2/setpoint", "u2/actual")]


def values_of(topic, cycle):
    return tuple(float(cycle) + place / 100 for place in range(len(topic.record._fields)))


def run(join, arrivals):
    """Offer (slot, cycle) in this order, step like a node; return what was stepped."""
    stepped = []
    for slot, cycle in arrivals:
        if join.offer(slot, cycle, values_of(join.inputs[slot], cycle)):
            while join.complete:
                number = join.cycle
                stepped.append((number, join.take()))
    return stepped


@st.composite
def arrivals(draw, slots, cycles):
    """Each topic's cycles in their order, the topics mixed in any way, some messages again later; number of those."""
    mixed = draw(st.permutations([slot for slot in range(slots) for _ in range(cycles)]))
    upcoming, order, seen, again = [0] * slots, [], [], 0
    for slot in mixed:
        order.append((slot, upcoming[slot]))
        seen.append(order[-1])
        upcoming[slot] += 1
        for repeated in draw(st.lists(st.sampled_from(seen), max_size=2)):
            order.append(repeated)
            again += 1
    return order, again


@settings(derandomize=True, max_examples=100, deadline=None)
@given(arrivals(slots=4, cycles=6))
def test_any_order_of_arrival_gives_the_same_steps(arrived):
    order, again = arrived
    join = CycleJoin(MONITOR)
    expected = [(cycle, [values_of(topic, cycle) for topic in MONITOR]) for cycle in range(6)]
    assert run(join, order) == expected
    assert join.ignored == again
    assert join.cycle == 6


def test_a_duplicate_does_not_replace_what_was_there_first():
    join = CycleJoin(DRIVE)
    join.offer(0, 0, (1.0, 2.0, 3.0))
    assert not join.offer(0, 0, (9.0, 9.0, 9.0))
    assert join.offer(1, 0, values_of(DRIVE[1], 0))
    assert join.take()[0] == (1.0, 2.0, 3.0)
    assert join.ignored == 1


def test_a_late_message_is_ignored_even_when_its_values_are_bad():
    join = CycleJoin(DRIVE)
    run(join, [(slot, cycle) for cycle in range(5) for slot in (0, 1)])
    assert not join.offer(0, 2, (math.nan,) * 3)
    assert join.ignored == 1


@pytest.mark.parametrize(("first", "slot", "name"), [(5, 0, "u2/setpoint"), (1841, 1, "u2/actual")])
def test_a_skipped_cycle_is_a_fault_naming_topic_and_both_numbers(first, slot, name):
    join = CycleJoin(DRIVE)
    run(join, [(slot, cycle) for cycle in range(first)])
    with pytest.raises(MachineFault, match=f"^{name}: cycle {first + 1} received, cycle {first} expected$"):
        join.offer(slot, first + 1, values_of(DRIVE[slot], first + 1))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    ("slot", "place", "name"),
    [(0, 0, "position.x"), (0, 8, "acceleration.z"), (0, 10, "feed"), (2, 1, "slider_position")],
)
def test_what_is_no_finite_number_is_a_fault_naming_topic_field_and_cycle(slot, place, name, value):
    join = CycleJoin(MONITOR)
    values = list(values_of(MONITOR[slot], 0))
    values[place] = value
    with pytest.raises(MachineFault, match=rf"^{MONITOR[slot].name}: {name} is {value} in cycle 0, a finite number"):
        join.offer(slot, 0, tuple(values))


@pytest.mark.parametrize("name", ["motor_speed", "current", "torque"])
def test_a_drive_without_a_motor_may_have_no_current(name):
    join = CycleJoin(MONITOR)
    values = list(values_of(MONITOR[1], 0))
    values[MONITOR[1].record._fields.index(name)] = math.nan
    join.offer(1, 0, tuple(values))
    assert join.missing() == [MONITOR[0], MONITOR[2], MONITOR[3]]


def test_large_numbers_are_finite():
    join = CycleJoin(DRIVE)
    join.offer(0, 0, (1e308, 1e308, 1e308))
    assert join.missing() == [DRIVE[1]]


def test_what_is_missing_is_named_for_the_next_cycle():
    join = CycleJoin(MONITOR)
    run(join, [(0, 0), (0, 1), (1, 0), (2, 0), (3, 0), (2, 1)])
    assert join.cycle == 1
    assert [topic.name for topic in join.missing()] == ["u1/actual", "u3/actual"]


def test_a_node_without_inputs_has_nothing_to_step():
    assert not CycleJoin([]).complete
