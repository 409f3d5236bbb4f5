"""Words of a command line as people type them: made readable for Hydra where one thing can be meant, else refused.

Outside quotes Hydra's grammar takes no `~` and no letters but those of English, and its parser answers an option that
it does not know with a page.
"""

import re
from collections import deque
from collections.abc import Sequence
from functools import cache

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException

from ablate.setting import did_you_mean
from ablate.settings.conf import allowed_for, choices_of, keys, nearest
from ablate.settings.study import ConfigurationError

#: Options of Hydra's parser, the long ones also cut short, and whether a value follows; a test reads `--hydra-help`.
OPTIONS = {
    **dict.fromkeys(("--help", "--hydra-help", "--version", "--resolve", "--run", "--multirun"), False),
    **dict.fromkeys(("-h", "-r", "-m", "--shell-completion", "-sc"), False),
    **dict.fromkeys(("--cfg", "--package", "--config-path", "--config-name", "--config-dir"), True),
    **dict.fromkeys(("-c", "-p", "-cp", "-cn", "-cd", "--experimental-rerun", "--info", "-i"), True),
}
_CFG = ("--cfg", "-c")
_INFO = ("--info", "-i")
#: What may follow an option of these; `--info` alone means all of it.
_CHOICES = {
    **dict.fromkeys(_CFG, ("job", "hydra", "all")),
    **dict.fromkeys(_INFO, ("all", "config", "defaults", "defaults-tree", "plugins", "searchpath")),
}
MULTIRUN = ("-m", "--multirun")


def quoted(path: object) -> str:
    """A path as Hydra reads it in `key=value`, with blanks, commas, brackets and quotes."""
    return "'" + str(path).replace("'", "\\'") + "'"


def readable(words: Sequence[str]) -> list[str]:
    """The words after `python -m ablate` as Hydra reads them: settings, then options, whose order it minds.

    A text that its grammar cannot read, such as a path with `~`, is put in quotes, unless it may stand for several
    values. What looks like an option and is none is a ConfigurationError that says how the setting is typed, and so is
    an option without what follows it.
    """
    settings: list[str] = []
    options: list[str] = []
    named: set[str] = set()
    left = deque(words)
    while left:
        word = left.popleft()
        if word[:1] != "-":
            _check_dash(word)
            _check_comma(word)
            _check_choice(word)
            _check_removal(word)
            settings.append(_readable(word))
            continue
        name, _, value = word.partition("=")
        option = next((o for o in OPTIONS if o == name or (len(name) > 2 and o.startswith(name))), None)
        if option is None:
            raise ConfigurationError(_no_option(word, left[0] if left else ""))
        options.append(word)
        if OPTIONS[option] and left and "=" not in word + left[0]:
            value = left.popleft()
            options.append(value)
        _check_option(option, value)
        named.add(option)
    if named & {"--package", "-p"} and not named & set(_CFG):
        raise ConfigurationError("--package names what --cfg shows: add --cfg job")
    _check_once(settings)
    return [*settings, *options]


def _readable(word: str) -> str:
    key, is_given, value = word.partition("=")
    if not is_given or key.lstrip("+") not in _texts() or value[:1] in ("'", '"') or set(value) & set(",[]{}"):
        return word
    try:
        OverridesParser.create().parse_override(word)
    except HydraException:
        return f"{key}={quoted(value)}"
    return word


@cache
def _texts() -> frozenset[str]:
    return frozenset(key for key, one in keys().items() if one.kind is str)


def _no_option(word: str, following: str) -> str:
    """Why `--preset tiny` is refused, and any other option that Hydra's parser does not have."""
    name, is_given, value = word.partition("=")
    key = name.lstrip("-").replace("-", "_")
    value = value if is_given else "" if following.startswith("-") or "=" in following else following
    known = key if key in keys() or any(other.startswith(f"{key}.") for other in keys()) else nearest(key)
    if known:
        return f"{name}: a setting is typed without dashes: {known}={value or '...'}"
    options = ", ".join(option for option in OPTIONS if option[:2] == "--")
    return f"{name}: no such option; allowed are key=value and {options}"


def _check_dash(word: str) -> None:
    """Refuse the long dash that a page or a letter makes of `-m`."""
    if word[:1] in ("\N{EN DASH}", "\N{EM DASH}", "\N{MINUS SIGN}"):
        raise ConfigurationError(f"{word}: begins with a long dash; type -{word[1:]}")


def _check_option(option: str, value: str) -> None:
    """Refuse an option without what follows it, of which Hydra's parser prints a page."""
    allowed = ", ".join(_CHOICES.get(option, ()))
    if value and allowed and value not in _CHOICES[option]:
        raise ConfigurationError(f"{option} {value}: allowed are {allowed}{did_you_mean(value, _CHOICES[option])}")
    if OPTIONS[option] and not value and option not in _INFO:
        raise ConfigurationError(f"{option}: nothing follows it; allowed are {allowed or 'a name or a path'}")


def _check_once(settings: Sequence[str]) -> None:
    """Refuse a group of ours that is chosen twice, once with `+`; Hydra takes one of the two and says nothing."""
    typed = {word.partition("=")[0] for word in settings}
    for key in typed:
        if key[:1] == "+" and key.lstrip("+") in typed and choices_of(key.lstrip("+")):
            raise ConfigurationError(f"{key}: one is chosen already; type {allowed_for(key.lstrip('+'))}")


def _check_comma(word: str) -> None:
    """Refuse a number with a comma in it, such as `0,001` or `1,000`; no value of a list has such zeros in front."""
    if hint := with_a_point(word, r"0\d+"):
        raise ConfigurationError(f"{word}: a comma separates the values of several jobs; {hint}")


def _check_choice(word: str) -> None:
    """Refuse several files of a group of ours for one job, of which Hydra takes the last: `variant=[sa2h,nsa2h]`."""
    key, _, value = word.partition("=")
    several = re.search(r"\[([^]]*,[^]]*)\]", value)
    if several and set(several[1].split(",")) & set(choices_of(key.lstrip("+"))):
        raise ConfigurationError(f"{word}: allowed is one for each job; type -m {key}={several[1]}")


def _check_removal(word: str) -> None:
    """Refuse `~tracking`, after which its settings have other values, and nothing says so."""
    key = word[1:].partition("=")[0]
    if word[:1] == "~" and (allowed := allowed_for(key)):
        raise ConfigurationError(f"{word}: a setting cannot be removed, but have another value: {allowed}")


def with_a_point(word: str, after: str = r"\d+") -> str:
    """How the number of `key=0,5` or `key=1,000` is typed, where its setting is one number; empty for other words."""
    key, _, value = word.partition("=")
    number = re.fullmatch(rf"(-?\d+),({after})", value)
    kind = keys()[key].kind if key in keys() else None
    if not number or not (kind is float or (kind is int and len(number[2]) == 3)):
        return ""
    return f"type {key}={number[1]}{'.' if kind is float else ''}{number[2]}"
