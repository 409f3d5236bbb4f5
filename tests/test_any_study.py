"""Settings drawn from all declared ranges: a tiny study of them finishes, or one line says why it does not."""

import io
import math
import resource
import sys
import warnings
from collections.abc import Callable
from contextlib import ExitStack, redirect_stderr, redirect_stdout
from enum import Enum
from itertools import count
from pathlib import Path
from typing import Any, get_args, get_origin
from unittest import mock

import pytest
from hypothesis import HealthCheck, Phase, example, given, settings
from hypothesis import strategies as st

from ablate.__main__ import main
from ablate.setting import Setting
from ablate.settings.conf import keys
from support.studies import Unrendered

STUDY = ("preset=tiny", "training.steps=2", "training.validate_every=1", "evaluation.pictures=1")
PHASES = (Phase.explicit, Phase.generate)
# Where more costs time or memory and nothing else, so that every draw is a study of seconds.
AT_MOST = {
    "simulator.scanlines": 64,
    "simulator.axial_samples": 256,
    "simulator.rays": 8,
    "simulator.layers": 3,
    "simulator.image_shape": 160,
    "dataset.frames": 12,
    "dataset.grid": 4,
    "dataset.workers": 1,
    "model.width": 0.1,
    "training.discriminator_width": 0.1,
    "training.steps": 4,
    "training.batch_size": 4,
    "training.crop": 160,
    "training.threads": 2,
    "crops.workers": 2,
    "evaluation.noise_draws": 4,
    "evaluation.timed_frames": 2,
}
DRAWN = {
    key: one
    for key, one in keys().items()
    if key.partition(".")[0] in {"seed", "encoding", "simulator", "dataset", "model", "crops", "training", "evaluation"}
    and one.kind is not str
}


def numbers(key: str, one: Setting, kind: type) -> st.SearchStrategy[Any]:
    """Numbers of the declared range, its ends and next to them more often than others."""
    low = one.declared.least if one.declared.least is not None else one.declared.above
    high = AT_MOST.get(key, one.declared.most if one.declared.most is not None else one.declared.below)
    if kind is int:
        ends = [end for end in (low, high) if end is not None]
        whole = st.integers(None if low is None else int(low), 2**40 if high is None else int(high))
        return st.one_of(st.sampled_from([int(end) for end in ends]), whole) if ends else whole
    floats = st.floats(low, high, allow_nan=False, allow_infinity=False)
    near = [float(f"{end:.17g}") for end in (low, high) if end is not None]
    near += [math.nextafter(end, other) for end, other in ((low, math.inf), (high, -math.inf)) if end is not None]
    return (st.one_of(st.sampled_from(near), floats) if near else floats).filter(one.declared.holds)


def values(key: str, one: Setting) -> st.SearchStrategy[str]:
    """Values of a key as the command line takes them."""
    if isinstance(one.kind, type) and issubclass(one.kind, Enum):
        drawn: st.SearchStrategy[str] = st.sampled_from([str(member.value) for member in one.kind])
    elif one.kind is bool:
        drawn = st.sampled_from(["true", "false"])
    elif get_origin(one.kind) is tuple:
        kinds = get_args(one.kind)
        drawn = st.tuples(*(numbers(key, one, kind) for kind in kinds)).map(lambda x: f"[{','.join(map(repr, x))}]")
    else:
        drawn = numbers(key, one, one.kind).map(repr)
    return st.one_of(drawn, st.just("null")) if one.optional else drawn


CHANGES = st.lists(st.sampled_from(sorted(DRAWN)), min_size=1, max_size=3, unique=True).flatmap(
    lambda chosen: st.tuples(*(values(key, DRAWN[key]).map(f"{key}={{}}".format) for key in chosen))
)


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., tuple[int, str, Path]]:
    """Runs the program; gives its exit code, what it printed on stderr, and the folder of its study."""
    runs, numbered = tmp_path_factory.mktemp("runs"), count()

    def run(*changes: str) -> tuple[int, str, Path]:
        name, err = f"study{next(numbered)}", io.StringIO()
        argv = ["ablate", *STUDY, f"runs_dir={runs}", f"study_name={name}", *changes]
        figure = mock.patch("ablate.analysis.figures.style.Figure", Unrendered)
        with ExitStack() as stack:
            for context in (mock.patch.object(sys, "argv", argv), figure, warnings.catch_warnings(action="ignore")):
                stack.enter_context(context)
            stack.enter_context(redirect_stdout(io.StringIO()))
            stack.enter_context(redirect_stderr(err))
            with pytest.raises(SystemExit) as end:
                main()
        code = end.value.code
        return (code, err.getvalue(), runs / name) if isinstance(code, int) else (1, str(code), runs / name)

    return run


@pytest.mark.slow
@settings(max_examples=500, deadline=None, suppress_health_check=list(HealthCheck), phases=PHASES)
@given(changes=CHANGES)
@example(changes=("simulator.image_shape=[160,1]",))  # its contact sheet once took 23 GB
def test_a_study_finishes_or_is_refused_in_one_line(
    outcome: Callable[..., tuple[int, str, Path]], changes: tuple[str, ...]
) -> None:
    code, printed, study = outcome(*changes)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < 4 << 20, "more than 4 GiB"
    if code == 0:
        assert list(study.glob("*/trained.json"))
        return
    assert "Traceback" not in printed
    if code == 2:
        assert printed.startswith("ablate: ")
        assert len(printed.splitlines()) == 1
    else:
        assert printed.splitlines()[-1].startswith("not finished: ")
