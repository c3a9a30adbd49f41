"""The recorder's ledger: when is a cycle complete, when is the run whole?"""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pkm_cnc.errors import MachineFault
from pkm_cnc.nodes.ledger import Ledger

SERVO = ["a", "b", "b/actual"]


def ledger() -> Ledger:
    return Ledger(SERVO, ["b/actual"])


def fill(book: Ledger, last: int) -> None:
    for cycle in range(last + 1):
        for topic in SERVO:
            book.take(topic, cycle)
    book.take("b/actual", last + 1)


def test_a_cycle_is_complete_when_the_last_of_its_messages_is_there() -> None:
    book = ledger()
    assert book.complete == -1
    book.take("b/actual", 0)
    book.take("b/actual", 1)
    book.take("a", 0)
    assert (book.complete, book.late()) == (-1, "b")
    book.take("b", 0)
    assert (book.complete, book.late()) == (0, "a")


def test_a_message_again_is_counted_and_not_taken() -> None:
    book = ledger()
    assert book.take("a", 0)
    assert not book.take("a", 0)
    assert book.ignored == 1


def test_a_skipped_cycle_is_a_fault_naming_topic_and_both_numbers() -> None:
    book = ledger()
    book.take("a", 0)
    with pytest.raises(MachineFault, match=r"^a: cycle 2 received, cycle 1 expected$"):
        book.take("a", 2)


def test_a_run_is_whole_with_its_last_actual_its_segments_and_its_summaries() -> None:
    book = ledger()
    fill(book, 4)
    assert not book.whole
    book.ends_with(4, 1)
    assert not book.whole
    book.take_segment(0, evaluated=False)
    book.take_segment(1, evaluated=True)
    assert not book.whole
    book.take_summary()
    assert not book.whole
    book.finished(commands=0, events=0)
    assert book.whole


def test_a_run_is_whole_with_all_the_commands_and_events_that_its_last_status_counts() -> None:
    book = ledger()
    fill(book, 4)
    book.ends_with(4, 0)
    book.take_segment(0, evaluated=False)
    book.take_told("program/event")
    book.finished(commands=1, events=2)
    assert not book.whole
    book.take_told("program/event")
    assert not book.whole
    book.take_told("operator/command")
    assert book.whole


def test_a_segment_again_does_not_count_and_a_skipped_one_is_a_fault() -> None:
    book = ledger()
    assert book.take_segment(0, evaluated=True)
    assert not book.take_segment(0, evaluated=True)
    assert book.ignored == 1
    with pytest.raises(MachineFault, match=r"^toolpath/segment: segment 2 received, segment 1 expected$"):
        book.take_segment(2, evaluated=True)


def test_without_the_actual_behind_the_last_cycle_it_is_not_whole() -> None:
    book = ledger()
    for cycle in range(3):
        for topic in SERVO:
            book.take(topic, cycle)
    book.ends_with(2, 0)
    book.finished(commands=0, events=0)
    book.take_segment(0, evaluated=False)
    assert not book.whole
    book.take("b/actual", 3)
    assert book.whole


@settings(derandomize=True, max_examples=100)
@given(st.lists(st.sampled_from(SERVO), max_size=60))
def test_in_any_order_the_complete_cycle_is_the_least_advanced_topic(order: list[str]) -> None:
    book, counts = ledger(), dict.fromkeys(SERVO, 0)
    for topic in order:
        book.take(topic, counts[topic])
        counts[topic] += 1
        assert book.complete == min(counts.values()) - 1
