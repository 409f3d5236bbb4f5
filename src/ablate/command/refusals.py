"""What Hydra cannot compose, said in one line with what is allowed."""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches

from hydra.errors import HydraException, OverrideParseException
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException
from yaml import YAMLError

from ablate.extras import installing
from ablate.setting import shown
from ablate.settings.conf import conf_folder, keys
from ablate.settings.study import ConfigurationError

# Launchers that Hydra knows where an extra is installed.
_EXTRAS = {"joblib": "parallel", "submitit_slurm": "slurm", "submitit_local": "slurm"}


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
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigurationError(_explained(error)) from error
    except (TypeError, ValueError, YAMLError, RecursionError, AttributeError) as error:
        # Hydra's own, where a file of conf/ is named by something that is no text, or cannot be read.
        if isinstance(error, ConfigurationError):
            raise
        known = "" if isinstance(error, YAMLError) else _of_a_group(words)  # a YAMLError names file and line
        raise ConfigurationError(known or _one_line(error)) from error


def _unreadable(error: OverrideParseException) -> str:
    """A word that is not of Hydra's grammar, with what helps."""
    key, is_given, value = error.override.partition("=")
    if not is_given:
        return f"{shown(key)}: allowed are key=value and the options of --help"
    if value.startswith(("'", '"')):
        return _one_line(error)
    hint = "without the comma at its end" if value.endswith(",") else f"in quotes: \"{key}='...'\""
    return f"{key}: Hydra cannot read the value {shown(value)}; give it {hint}"


def _of_a_group(words: Sequence[str]) -> str:
    """A word that names a group of conf/ with a value that is no name; empty where there is none."""
    for word in words:
        group, _, value = word.partition("=")
        names = sorted(path.stem for path in (conf_folder() / group).glob("*.yaml")) if group else []
        if names and value not in names:
            return f"{word}: allowed are {', '.join(names)}"
    return ""


def _explained(error: Exception) -> str:
    """Hydra's message on one line, with what is allowed where a key or a choice is unknown."""
    for launcher, extra in _EXTRAS.items():
        if f"'hydra/launcher/{launcher}'" in str(error):
            return f"hydra/launcher: {launcher} is not installed: {installing(extra)}"
    unknown_choice = r"Could not find '(.+)/([^/]+)'\s+Available options in '.+?':(.*?)\n\s*Config search"
    if choice := re.search(unknown_choice, str(error), re.S):
        return f"{choice[1]}={choice[2]}: allowed are {', '.join(choice[3].split())}"
    if several := re.search(r"Ambiguous value for argument '(.*)'", str(error)):
        return f"'{several[1]}' asks for several jobs: add -m"
    cause = error.__cause__ if isinstance(error.__cause__, OmegaConfBaseException) else error
    text = _one_line(error).partition("; Config search path")[0]
    if cause is error:
        key = getattr(error, "full_key", None)
        text = f"{key}: {text}" if key and key not in text else text
    else:
        text = f"{text}: {_one_line(cause)}"
    return _unknown_key(cause, text) or text.removeprefix("Error merging override ")


def _unknown_key(cause: BaseException, text: str) -> str:
    """An unknown key with the nearest known one; empty where the message is about something else."""
    key = str(getattr(cause, "full_key", None) or "")
    is_unknown = r"(?:Key|key) '([^']+)' (?:is not in struct|not in '\w+')"
    if not key or not re.search(is_unknown, f"{text} {_one_line(cause)}"):
        return ""
    parent, _, last = key.rpartition(".")
    prefix = f"{parent}." if parent else ""
    names = sorted({known.removeprefix(prefix).partition(".")[0] for known in keys() if known.startswith(prefix)})
    if not names:
        return ""
    close = get_close_matches(last, names, n=1)
    hint = f"; did you mean '{close[0]}'?" if close else ""
    return f"unknown key '{key}'{hint} allowed{' in ' + parent if parent else ''}: {', '.join(names)}"


def _one_line(error: BaseException) -> str:
    details = ("full_key:", "object_type=", "reference_type=", "To append to your config")
    lines = [line.strip() for line in str(error).splitlines()]
    return "; ".join(line for line in lines if line and not line.startswith(details))
