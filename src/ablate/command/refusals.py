"""What Hydra cannot compose, said in one line with what is allowed."""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, get_origin

from hydra.errors import HydraException, OverrideParseException
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException, ValidationError
from yaml import YAMLError

from ablate.command.words import with_a_point
from ablate.extras import installing
from ablate.setting import did_you_mean, shown
from ablate.settings.conf import CUSTOM, allowed_for, choices_of, keys, nearest, unknown_key
from ablate.settings.study import ConfigurationError

# Launchers that Hydra knows where an extra is installed.
_EXTRAS = {"joblib": "parallel", "submitit_slurm": "slurm", "submitit_local": "slurm"}
# Sweepers that Hydra documents, and the packages that have them.
_SWEEPERS = {name: f"hydra-{name}-sweeper" for name in ("optuna", "nevergrad", "ax")}


@contextmanager
def in_one_line(words: Sequence[str] = ()) -> Iterator[None]:
    """Turn what Hydra and the settings raise into a ConfigurationError; `words` are those of the command line."""
    try:
        yield
    except MissingMandatoryValue as error:
        key = error.full_key or "a value"
        raise ConfigurationError(f"{key} must be given: {key}=...") from error
    except OverrideParseException as error:
        raise ConfigurationError(_unreadable(error)) from error
    except ConfigurationError as error:
        raise with_hint(error, words) from error
    except (HydraException, OmegaConfBaseException) as error:
        raise with_hint(ConfigurationError(_explained(error)), words) from error
    except (TypeError, ValueError, YAMLError, RecursionError, AttributeError) as error:
        # Hydra's own, where a file of conf/ is named by something that is no text, or cannot be read.
        known = "" if isinstance(error, YAMLError) else _of_a_group(words)  # a YAMLError names file and line
        raise with_hint(ConfigurationError(known or _one_line(error)), words) from error


def with_hint(error: Exception, words: Sequence[str]) -> Exception:
    """The refusal of a setting, with how it is typed where another one was meant; another error as it is.

    That is a number with a comma, and a setting of the user's network among those of the package.
    """
    if isinstance(error, ConfigurationError):
        if own := _of_own_network(str(error), words):
            return ConfigurationError(f"{error}; {own}")
        for word in words:
            hint = with_a_point(word)
            if hint and hint not in str(error) and word.partition("=")[0] in str(error):
                return ConfigurationError(
                    f"{error}; a comma separates the values of several jobs: for a number, {hint}"
                )
    return error


def _unreadable(error: OverrideParseException) -> str:
    """A word that is not of Hydra's grammar, with what helps."""
    key, is_given, value = error.override.partition("=")
    if not is_given:
        return f"{shown(key)}: allowed are key=value and the options of --help, no blank beside ="
    if "[" in key:
        return unknown_key(key)
    if value.startswith(("'", '"')):
        return _one_line(error)
    if any(value.count(left) != value.count(right) for left, right in ("[]", "{}", "()")):
        hint = "without blanks, and every bracket closed"
    elif value.endswith(","):
        hint = "without the comma at its end, or the blank after it"
    elif allowed_for(key) and (key not in keys() or keys()[key].kind is not str):
        hint = f"as {allowed_for(key)}"
    else:
        hint = f"in quotes: \"{key}='...'\""
    return f"{key}: Hydra cannot read the value {shown(value)}; give it {hint}"


def _of_a_group(words: Sequence[str]) -> str:
    """A word that names a group of conf/ with a value that is no name; empty where there is none."""
    for word in words:
        group, _, value = word.partition("=")
        names = choices_of(group)
        if names and value not in names:
            return f"{word}: allowed are {', '.join(names)}{did_you_mean(value, names)}"
    return ""


def _explained(error: Exception) -> str:
    """Hydra's message on one line, with what is allowed where a key or a choice is unknown."""
    for launcher, extra in _EXTRAS.items():
        if f"'hydra/launcher/{launcher}'" in str(error):
            return f"hydra/launcher: {launcher} is not installed: {installing(extra)}"
    for sweeper, package in _SWEEPERS.items():
        if f"'hydra/sweeper/{sweeper}'" in str(error):
            return f"hydra/sweeper: {sweeper} is not installed: pip install {package}"
    if group := re.search(r"No match in the defaults list.\s+To append .* use \+(\S+)$", str(error)):
        return f"{group[1]}: nothing is chosen of this group yet; type +{group[1]}"
    unknown_choice = r"Could not find '(.+)/([^/]*)'\s+Available options in '.+?':(.*?)\n\s*Config search"
    if choice := re.search(unknown_choice, str(error), re.S):
        names = choice[3].split()
        return f"{choice[1]}={choice[2]}: allowed are {', '.join(names)}{did_you_mean(choice[2], names)}"
    if several := re.search(r"Ambiguous value for argument '(.*)'", str(error)):
        key, _, value = several[1].partition("=")
        is_list = key in keys() and (keys()[key].kind is Any or get_origin(keys()[key].kind) is tuple)
        hint = f", or type {key}=[{value}]" if is_list else ""
        is_known = allowed_for(key) or not nearest(key)
        return f"'{several[1]}' asks for several jobs: add -m{hint}" + ("" if is_known else f"; {unknown_key(key)}")
    if twice := re.search(r"Multiple values for (\S+)\. To override|force-add of .*: '\++([^=]+)=", str(error)):
        key = twice[1] or twice[2]
        return f"+{key}: one is chosen already; type {allowed_for(key) or f'{key}=...'}"
    if "Primary config module" in str(error) or "Cannot find primary config" in str(error):
        return (
            f"{_one_line(error)}; --config-dir=FOLDER adds your files to those of ablate, --config-name=FILE takes one"
        )
    chain = (error.__cause__, error, error.__context__)
    cause = next((e for e in chain if isinstance(e, OmegaConfBaseException)), error)
    if isinstance(cause, ValidationError) and (refused := _of_another_type(cause, str(error))):
        return refused
    text = _one_line(error).partition("; Config search path")[0]
    if cause is error:
        key = getattr(error, "full_key", None)
        text = f"{key}: {text}" if key and key not in text else text
    else:
        text = f"{text}: {_one_line(cause)}"
    file = re.match(r"In '[^']+': ", text)
    refused = _unknown_key(cause, text)
    return f"{file[0] if file else ''}{refused}" if refused else text.removeprefix("Error merging override ")


def _of_another_type(cause: ValidationError, text: str) -> str:
    """A value that is not of its setting's type, with what is allowed; empty where the setting is not known."""
    key = str(cause.full_key or "")
    if key not in keys():  # as probe.kind, which is that of its keys
        of_enum = re.search(r"value '(.*)', expected one of \[(.*)\]", str(cause))
        names = of_enum[2].split(", ") if of_enum else []
        if of_enum:
            return f"{key}={of_enum[1]}: allowed are {of_enum[2]}{did_you_mean(of_enum[1], names)}"
        return f"{key}: a group of settings; allowed are {allowed_for(key)}" if allowed_for(key) else ""
    typed = re.search(rf"override {re.escape(key)}=(.*)", text) or re.search(r"[vV]alue '(.*?)'", str(cause))
    value = typed[1] if typed else "..."
    whole = re.fullmatch(r"[-+]?\d+(\.\d*)?(e\+?\d+)?", value, re.IGNORECASE)
    hint = f"; type {key}={float(value):.0f}" if keys()[key].kind is int and whole and float(value) % 1 == 0 else ""
    if value.startswith("["):
        hint = f"; for several jobs, type -m {key}={value.strip('[]')}"
    return f"{key}={value}: allowed are {keys()[key].allowed}{hint}{did_you_mean(value, keys()[key].choices)}"


def _unknown_key(cause: BaseException, text: str) -> str:
    """An unknown key with the nearest known one; empty where the message is about something else."""
    key = str(getattr(cause, "full_key", None) or "")
    is_unknown = r"(?:Key|key) '([^']+)' (?:is not in struct|not in '\w+')"
    if not key or not re.search(is_unknown, f"{text} {_one_line(cause)}"):
        return ""
    typed = re.search(rf"override \W*({re.escape(key)}[\w.]*)[=']", text)  # whole, of which OmegaConf names a part
    return unknown_key(typed[1] if typed and not nearest(key) else key)


def _of_own_network(refusal: str, words: Sequence[str]) -> str:
    """How an unknown key is typed as a setting of the user's network; empty where a command names none."""
    typed = dict(word.lstrip("+").partition("=")[::2] for word in words)
    names_one = "model.target" in typed or CUSTOM in typed.get("variant", "").split(",")
    unknown = re.match(r"unknown key '((?:model\.)?(\w+))'", refusal)
    if not names_one or not unknown or "model.settings." in refusal:
        return ""
    return f"a setting of your own network is typed model.settings.{unknown[2]}={typed.get(unknown[1], '...')}"


def _one_line(error: BaseException) -> str:
    details = ("full_key:", "object_type=", "reference_type=", "To append to your config")
    lines = [line.strip() for line in str(error).splitlines()]
    return "; ".join(line for line in lines if line and not line.startswith(details))
