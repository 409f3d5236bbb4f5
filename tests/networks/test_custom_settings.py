"""Settings of a user's network are its keyword arguments, and what its class does not take is named."""

import sys
from pathlib import Path

import pytest

from ablate.networks import GeneratorSpec, check_custom, count_generator

MODULE = """
from __future__ import annotations
from collections import OrderedDict
from enum import StrEnum
from typing import Literal
from torch import nn

class Norm(nn.Identity):
    pass

class Net(nn.Sequential):
    def __init__(self, channels, hidden: int, norm: Literal["none", "instance"] = "none", scale: float | None = None,
                 sizes: list[int] = (3,), bias=True, rate=1, act: nn.Module | None = None):
        super().__init__(
            nn.Conv2d(channels, hidden, sizes[0], padding=sizes[0] // 2, bias=bias), nn.ReLU(), nn.Conv2d(hidden, 1, 1)
        )
        sizes and isinstance(sizes, list) and sizes.append(9)

class Plain(nn.Conv2d):
    def __init__(self, channels):
        super().__init__(channels, 1, 3, padding=1)

class Kind(StrEnum):
    wide = "wide"
    narrow = "narrow"

class Named(Plain):
    def __init__(self, channels, kind=Kind.wide, sides=OrderedDict(low=1)):
        super().__init__(channels)
        assert kind in list(Kind)

Named.__init__.__annotations__["sides"] = [int]  # no type, as beginners write it

class Open(Plain):
    def __init__(self, channels, **others):
        super().__init__(channels)
        if others.get("broken"):
            raise RuntimeError("so it is")
"""
REFUSED = {
    "a slip": ("Net", {"hiden": 3}, r"settings\.hiden=3: did you mean settings\.hidden\? .* takes hidden"),
    "another key": ("Net", {"hidden": 3, "depth": 1}, r"settings\.depth=1: .*Net takes hidden \(a whole number\)"),
    "what ablate gives": ("Net", {"hidden": 3, "channels": 1}, r"settings\.channels=1: own_net\.Net takes hidden"),
    "what ablate gives, beside any": ("Open", {"channels": 1}, r"settings\.channels=1: own_net\.Open takes "),
    "missing": ("Net", {}, r"settings\.hidden=\.\.\. must be given: own_net\.Net takes hidden \("),
    "text for a whole number": ("Net", {"hidden": "8"}, r"settings\.hidden='8': own_net\.Net takes a whole number"),
    "decimals": ("Net", {"hidden": 8.5}, r"settings\.hidden=8\.5: .*Net takes a whole number as hidden"),
    "true for a number": ("Net", {"hidden": True}, r"settings\.hidden=True: .*Net takes a whole number as hidden"),
    "a choice": ("Net", {"hidden": 3, "norm": "batch"}, r"settings\.norm='batch': .* takes none or instance as norm"),
    "of several kinds": ("Net", {"hidden": 3, "scale": "x"}, r"settings\.scale='x': .* takes a number or null as"),
    "no list": ("Net", {"hidden": 3, "sizes": 3}, r"settings\.sizes=3: .* takes a list as sizes"),
    "by its default": ("Net", {"hidden": 3, "bias": 1}, r"settings\.bias=1: .* takes true or false as bias"),
    "a default that is a number": ("Net", {"hidden": 3, "rate": "fast"}, r"settings\.rate='fast': .* takes a number"),
    "a default of a class": ("Named", {"kind": 3}, r"settings\.kind=3: own_net\.Named takes text as kind"),
    "none at all": ("Plain", {"hidden": 3}, r"settings\.hidden=3: own_net\.Plain takes its number of channels alone"),
    "fails for itself": ("Open", {"broken": 1}, r"target=.*: own_net.Open\(2, broken=1\) fails: RuntimeError: so"),
}  # fmt: skip


@pytest.fixture(autouse=True)
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "own_net.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "own_net", raising=False)


def spec(name: str, settings: dict[str, object]) -> GeneratorSpec:
    plain = {"concat": "input", "upsampling": "transposed", "noise": "none"}
    return GeneratorSpec(family="custom", target=f"own_net.{name}", settings=settings, **plain)


@pytest.mark.parametrize("case", REFUSED)
def test_what_a_class_does_not_take_is_refused(case: str) -> None:
    name, settings, message = REFUSED[case]
    with pytest.raises(ValueError, match=f"^{message}") as error:
        check_custom(spec(name, settings), 32)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "settings",
    [
        {"hidden": 8},
        {"hidden": 8, "scale": 2, "norm": "instance", "rate": 0.5},
        {"hidden": 8, "scale": None, "act": None, "sizes": [5], "bias": False},
    ],
)
def test_what_a_class_takes_is_what_it_is_made_with(settings: dict[str, object]) -> None:
    """The parameters of two convolutions, counted by hand; the class that writes to its list changes no other one."""
    of = spec("Net", settings)
    check_custom(of, 32)
    side = settings.get("sizes", [3])[0]  # type: ignore[index]
    expected = 2 * 8 * side**2 + 8 * settings.get("bias", True) + 8 + 1
    assert count_generator(of) == count_generator(of) == expected
    assert of.settings == settings
    check_custom(spec("Named", {"kind": "narrow", "sides": {"high": 2}}), 32)
    check_custom(spec("Open", {"anything": {"goes": [1, "a"]}}), 32)


def test_they_are_values_of_a_frozen_network() -> None:
    values: dict[str, object] = {"hidden": 8, "sizes": (3,)}
    of = spec("Net", values)
    values["hidden"] = 9
    assert of.settings == {"hidden": 8, "sizes": [3]}  # as JSON gives it back
    assert hash(of) == hash(spec("Net", {"hidden": 8, "sizes": [3]}))
    assert of != spec("Net", {"hidden": 9})


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 2**63, object(), {1: 2}, [b"x"]])
def test_a_value_that_json_cannot_hold_is_refused(value: object) -> None:
    with pytest.raises(ValueError, match=r"^settings=\{'hidden': .*allowed are names with numbers, text"):
        spec("Net", {"hidden": value})


def test_a_network_of_the_package_has_none() -> None:
    with pytest.raises(ValueError, match=r"^settings\.hidden=3 with family=local: .*variant=custom"):
        GeneratorSpec(settings={"hidden": 3})
