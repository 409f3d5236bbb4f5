"""Checks of names and addresses that several rooms share; declared settings are checked by `setting`."""

import re
import reprlib
from collections.abc import Collection

LONGEST_NAME = 200  # bytes; file systems take 255, and endings are added to names
_REPR = reprlib.Repr()
_REPR.maxstring = _REPR.maxother = 60
_REPR.maxlevel = 2


def shown(value: object) -> str:
    """Represent a value in a message, shortened where it is long."""
    return " ".join(_REPR.repr(value).split())


def check_name(key: str, value: str, reserved: Collection[str] = ()) -> None:
    """Raise ValueError unless `value` can name a folder and a run: letters, digits, blanks and `_.+-`.

    The part before its first dot, whatever its case, must not be one of the lower-case names in `reserved`.
    """
    if not re.fullmatch(r"\w([\w.+ -]*[\w.+-])?", value) or len(value.encode(errors="replace")) > LONGEST_NAME:
        allowed = f"at most {LONGEST_NAME} letters, digits, blanks and _.+-, the first a letter, a digit or _"
        raise ValueError(f"{key}={shown(value)}: allowed are {allowed}")
    if value.partition(".")[0].lower() in reserved:
        raise ValueError(f"{key}={value}: the names {', '.join(sorted(reserved))} are taken by other folders")


def check_store(key: str, uri: str) -> None:
    """Raise ValueError unless MLflow can track into `uri`: a server or a database, and no secret within."""
    if not re.match(r"(https?|(sqlite|postgresql|mysql|mssql)(\+\w+)?)://|databricks", uri):
        allowed = "http://, https://, sqlite:///, postgresql://, mysql:// and mssql:// with what follows"
        raise ValueError(f"{key}={shown(uri)}: allowed are {allowed}")
    if has_secret(uri):
        where = "MLFLOW_TRACKING_USERNAME and MLFLOW_TRACKING_PASSWORD, or PGPASSWORD for a database"
        raise ValueError(f"{key}: holds a user or a password; allowed is a URI without, and {where}")


def has_secret(uri: str) -> bool:
    """Whether a tracking URI names a password, or any user of a web server, whose name may be a token."""
    scheme, _, rest = uri.partition("://")
    if scheme.startswith(("sqlite", "file")):
        return False
    named = re.search(r"[?&;](\w*passw\w*|pwd|\w*token|\w*secret)=", rest, re.IGNORECASE)
    user = r".*@" if scheme.startswith("http") else r"[^@]*:.*@"
    return bool(named or re.match(user, rest))
