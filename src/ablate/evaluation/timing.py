"""How long calls take beside each other, on a machine whose speed changes from second to second."""

import time
from collections.abc import Callable, Mapping

import pandas as pd
from tqdm import tqdm

#: What is done around a call and not timed: (its name, number of the round).
Hook = Callable[[str, int], object]


def time_in_turns(
    calls: Mapping[str, Callable[[int], object]],
    rounds: int,
    *,
    warm_up: int = 1,
    before: Hook | None = None,
    after: Hook | None = None,
    what: str = "time",
) -> pd.DataFrame:
    """Time calls in turns: a round has one of each, and the next round takes them in the opposite order.

    Times of one round are of one moment, so they compare better than times that were measured one call after the other.

    Parameters
    ----------
    calls : dict of str to callable
        Given the number of the round, each does what is timed; one that uses a GPU has to wait for it.
    rounds : int
        How many count, numbered from 1.
    warm_up : int
        How many rounds are made before, not counted; the last has number 0, the one before it -1.
    before, after : callable, optional
        What is done before and after each call, without being timed.
    what : str
        Stands at the bar that shows how far it is.

    Returns
    -------
    DataFrame
        Columns call (its name), round and ms, in the order in which they were timed.
    """
    rows: list[tuple[str, int, float]] = []
    turns = list(calls)
    with tqdm(total=(warm_up + rounds) * len(turns), desc=what, unit="call", leave=False, disable=None) as bar:
        for number in range(1 - warm_up, rounds + 1):
            for name in turns:
                if before is not None:
                    before(name, number)
                start = time.perf_counter()
                calls[name](number)
                ms = 1e3 * (time.perf_counter() - start)
                if number > 0:
                    rows.append((name, number, ms))
                if after is not None:
                    after(name, number)
                bar.update()
            turns.reverse()
    return pd.DataFrame(rows, columns=["call", "round", "ms"])
