"""Calls are timed in turns; a clock that the calls themselves move says what each took."""

from functools import partial

import pytest

from ablate.evaluation import time_in_turns, timing


class Clock:
    """A clock in seconds that stands still until somebody moves it."""

    def __init__(self) -> None:
        self.now = 0.0

    def perf_counter(self) -> float:
        return self.now

    def pass_ms(self, ms: float, *_: object) -> None:
        self.now += ms / 1e3


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(timing, "time", made)
    return made


def test_each_call_has_its_own_time_and_what_is_beside_it_has_none(clock: Clock) -> None:
    calls = {"slow": lambda number: clock.pass_ms(70 + number), "fast": partial(clock.pass_ms, 3)}
    times = time_in_turns(calls, 4, before=partial(clock.pass_ms, 500), after=partial(clock.pass_ms, 900))
    of_call = times.groupby("call")["ms"].apply(list)
    assert of_call["slow"] == pytest.approx([71, 72, 73, 74])
    assert of_call["fast"] == pytest.approx([3, 3, 3, 3])


@pytest.mark.parametrize("warm_up", [0, 1, 2])
def test_the_order_turns_from_round_to_round_and_what_warms_up_is_not_counted(clock: Clock, warm_up: int) -> None:
    done: list[tuple[str, int]] = []

    def call(name: str, number: int) -> None:
        done.append((name, number))

    around: list[tuple[str, str, int]] = []
    times = time_in_turns(
        {name: partial(call, name) for name in "abc"},
        3,
        warm_up=warm_up,
        before=lambda name, number: around.append(("before", name, number)),
        after=lambda name, number: around.append(("after", name, number)),
    )
    numbers = list(range(1 - warm_up, 4))
    assert done == [
        (name, number) for turn, number in enumerate(numbers) for name in ("abc" if turn % 2 == 0 else "cba")
    ]
    assert list(zip(times["call"], times["round"], strict=True)) == [each for each in done if each[1] > 0]
    assert around == [(when, *each) for each in done for when in ("before", "after")]
    assert clock.now == 0


def test_nothing_to_time_is_a_table_without_rows() -> None:
    assert list(time_in_turns({}, 5).columns) == ["call", "round", "ms"]
