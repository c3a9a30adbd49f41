"""Whoever dies, the watchdog names it and not one of those who wait for it."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pkm_cnc.nodes.watchdog import OPERATOR, Report, Watchdog
from pkm_cnc.topics import CONTOUR_MONITOR, INTERPOLATOR, RECORDER, nodes, topics

AXES = ("u1", "u2", "u3")
NODES = nodes(AXES)
SERVO = {name: topic for name, topic in topics(AXES).items() if topic.record}
INPUTS = {node: [name for name, topic in SERVO.items() if node in topic.subscribers] for node in NODES}
OUTPUTS = {node: [name for name, topic in SERVO.items() if topic.publisher == node] for node in NODES}


class Stopped:
    """The graph after `dead` has stopped in cycle `last`, with the first `spoken` of its topics of that cycle sent.

    Nothing but the topic table and the contract: a node does cycle k when it holds all inputs of k, the interpolator
    is at most a window ahead of what contour_monitor and recorder have told.
    """

    def __init__(self, dead, last, spoken, window):
        self.dead, self.last, self.spoken, self.window = dead, last, spoken, window
        self.done = dict.fromkeys(NODES, 0)
        while sum(self.step(node) for node in NODES):
            pass

    def sent(self, topic):
        """Number of cycles that were published on a topic."""
        node = SERVO[topic].publisher
        ahead = 1 if topic.endswith("/actual") else 0
        if node == self.dead and self.done[node] == self.last:
            ahead += OUTPUTS[node].index(topic) < self.spoken
        return self.done[node] + ahead

    def lacks(self, node):
        return [name for name in INPUTS[node] if self.sent(name) <= self.done[node]]

    def told(self, node):
        stride = max(1, self.window // 4)
        return self.done[node] // stride * stride - 1

    def step(self, node):
        if node == self.dead and self.done[node] == self.last:
            return False
        if node == INTERPOLATOR:
            ready = self.done[node] <= min(self.told(CONTOUR_MONITOR), self.told(RECORDER)) + self.window
        else:
            ready = not self.lacks(node)
        self.done[node] += ready
        return ready

    def report(self, node):
        if node == INTERPOLATOR:
            slowest = min((CONTOUR_MONITOR, RECORDER), key=lambda name: (self.told(name), name))
            return Report(node, slowest, f"{slowest}/progress", self.told(slowest) + 1)
        topic = self.lacks(node)[0]
        return Report(node, SERVO[topic].publisher, topic, self.done[node])


def verdicts(stopped, limit, waits_since, looks_at):
    """Time and text of the first verdict of each node that lives; its clock looks at looks_at + n periods."""
    living = [node for node in NODES if node != stopped.dead]
    watchdogs = {node: Watchdog(limit) for node in living}
    reports = {node: stopped.report(node) for node in living}
    period = watchdogs[living[0]].period
    turns = math.ceil(1.25 * limit / period)
    looks = sorted((looks_at[node] * period + turn * period, node) for node in living for turn in range(turns))
    found = {}
    for time, node in looks:
        waited = time - waits_since[node]
        if node in found or not watchdogs[node].too_long(waited):
            continue
        for watchdog in watchdogs.values():
            watchdog.take(reports[node], time)
        text = watchdogs[node].verdict(waited, time)
        if text:
            found[node] = (time, text)
    return found


@pytest.mark.parametrize("dead", NODES)
@pytest.mark.parametrize("window", [1, 8, 16])
@settings(derandomize=True, max_examples=12, deadline=None)
@given(data=st.data())
def test_the_dead_node_is_named_by_all_whenever_they_look(dead, window, data):
    limit = data.draw(st.sampled_from([0.5, 1.0, 5.0, 12.0]))
    stopped = Stopped(dead, data.draw(st.integers(1, 25)), data.draw(st.integers(0, 3)), window)
    moments = st.floats(0.0, 1.0, exclude_max=True)
    looks_at = {node: data.draw(moments) for node in NODES}
    waits_since = {node: 0.02 * limit * data.draw(moments) for node in NODES}
    found = verdicts(stopped, limit, waits_since, looks_at)
    assert set(found) == set(NODES) - {dead}
    for time, text in found.values():
        assert text.startswith(f"{dead} has not answered cycle ")
        assert text.endswith(f" for {limit:g} s")
        assert limit <= time <= 1.25 * limit


def test_the_verdict_says_which_cycle_on_which_topic():
    stopped = Stopped("u2/plant", 184, 0, 8)
    zero = dict.fromkeys(NODES, 0.0)
    assert {text for _, text in verdicts(stopped, 5.0, zero, zero).values()} == {
        "u2/plant has not answered cycle 185 on u2/actual for 5 s"
    }


def test_nobody_is_blamed_while_it_is_too_early():
    watchdog = Watchdog(5.0)
    watchdog.take(Report("u1/servo_drive", "u1/plant", "u1/actual", 7), 4.9)
    assert watchdog.verdict(4.9, 4.9) == ""
    assert "u1/plant" in watchdog.verdict(5.1, 5.0)


def test_who_waited_once_and_went_on_is_not_excused_later():
    """A slow disk made everyone wait and say so; long after that the plant dies."""
    watchdog = Watchdog(5.0)
    for node, waits_for in (("u2/plant", "u2/servo_drive"), ("u2/servo_drive", "inverse_kinematics")):
        watchdog.take(Report(node, waits_for, "topic", 100), 4.0)
    watchdog.take(Report("u2/servo_drive", "u2/plant", "u2/actual", 5000), 63.0)
    assert watchdog.verdict(5.2, 65.2) == "u2/plant has not answered cycle 5000 on u2/actual for 5 s"


def waiting_for_the_operator(told_at):
    watchdog = Watchdog(5.0)
    watchdog.take(Report(INTERPOLATOR, OPERATOR, "operator/command", 100), told_at)
    watchdog.take(Report("inverse_kinematics", INTERPOLATOR, "tcp/setpoint", 100), 600.0)
    watchdog.take(Report("u2/servo_drive", "inverse_kinematics", "u2/setpoint", 100), 600.0)
    return watchdog


def test_while_the_operator_is_waited_for_nobody_is_missing():
    assert waiting_for_the_operator(599.5).verdict(595.0, 600.5) == ""


def test_an_interpolator_that_dies_while_it_waits_for_the_operator_is_named():
    verdict = waiting_for_the_operator(595.0).verdict(595.0, 600.5)
    assert verdict == "interpolator has not answered cycle 100 on tcp/setpoint for 5 s"


def test_a_node_that_died_meanwhile_is_named_when_the_interpolator_has_gone_on():
    watchdog = waiting_for_the_operator(599.5)
    watchdog.take(Report("u2/servo_drive", "u2/plant", "u2/actual", 101), 604.0)
    watchdog.take(Report("inverse_kinematics", INTERPOLATOR, "tcp/setpoint", 116), 604.0)
    watchdog.take(Report(INTERPOLATOR, "recorder", "recorder/progress", 100), 604.0)
    watchdog.take(Report("recorder", "u2/plant", "u2/actual", 101), 604.0)
    assert watchdog.verdict(8.0, 605.0) == "u2/plant has not answered cycle 101 on u2/actual for 5 s"


def test_waiting_is_told_before_it_is_judged():
    for limit in (0.1, 0.5, 5.0, 3600.0):
        watchdog = Watchdog(limit)
        told = next(waited for waited in (limit * part / 100 for part in range(200)) if watchdog.too_long(waited))
        assert limit - told > 2 * watchdog.period
