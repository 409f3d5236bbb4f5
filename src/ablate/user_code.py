"""Code of the user's own, named by a dotted path: loaded, and known by a digest of its source files."""

import ast
import hashlib
import sys
import sysconfig
from collections.abc import Mapping
from contextlib import suppress
from functools import lru_cache
from importlib import import_module
from importlib.machinery import ModuleSpec
from importlib.util import find_spec, resolve_name
from pathlib import Path
from types import ModuleType
from typing import Any

_PACKAGE = Path(__file__).parent
_INSTALLED = {"site-packages", "dist-packages"}
_OF_PYTHON = tuple({Path(sysconfig.get_path(name)) for name in ("stdlib", "platstdlib")})


def load(path: str) -> Any:
    """Import a module and return what a dotted path, such as `my_package.MyGenerator`, names in it.

    Where the path names no module, the import fails, or the module does not have the name, it is a ValueError whose
    message says why in one line; the caller puts the key of the setting before it.
    """
    module, _, name = path.rpartition(".")
    if not module:
        raise ValueError("names no module")
    try:
        loaded = getattr(import_module(module), name)
        check_dtype()
        return loaded
    except (Exception, SystemExit) as error:  # whatever the user's module does
        raise ValueError(describe_error(error)) from error


def check_dtype() -> None:
    """Undo what the user's code has set with `torch.set_default_dtype`, and refuse it: it holds for all networks."""
    torch = sys.modules.get("torch")
    if torch is not None and torch.get_default_dtype() is not torch.float32:
        torch.set_default_dtype(torch.float32)
        raise ValueError("sets torch's default dtype, also of other networks; allowed is dtype= of its own tensors")


def load_anew(path: str) -> Any:
    """What `load` gives in another process: modules of the user's own are run again, and those that are loaded stay.

    Those that cannot be run twice, or that were edited since they were loaded, are taken as they are.
    """
    files = _files(*_holders(path))
    user_modules = [name for name in files if name in sys.modules and name != "__main__" and _own_file(name)]
    if not user_modules or _digest_of(files) != code_digest(path):
        return load(path)
    loaded = {name: sys.modules.pop(name) for name in user_modules}
    try:
        anew = load(path)
    except ValueError:
        anew = None
    for name in files.keys() - loaded.keys():
        if _own_file(name):
            sys.modules.pop(name, None)
    sys.modules.update(loaded)
    return load(path) if anew is None else anew


def describe_error(error: BaseException) -> str:
    """Describe an error of the user's code: its type and at most 200 characters of its message."""
    return f"{type(error).__name__}: {' '.join(str(error).split()):.200}"


class UnnamedCodeError(ValueError):
    """A file names code that the user did not name; nothing of it was imported."""


def check_named(source: Path, target: object, custom: str | None, key: str) -> None:
    """Refuse the code that a file names unless the user names it too: reading a result runs no code of its maker.

    Parameters
    ----------
    source : Path
        The file.
    target : object
        The dotted path in it; None where it names no code. It may be anything, as its maker wrote it.
    custom : str or None
        The dotted path that the user named.
    key : str
        What the user names it by, as `custom`.

    Raises
    ------
    UnnamedCodeError
        In one line, where both differ.
    """
    if target is not None and target != custom:
        raise UnnamedCodeError(
            f"{source}: names code, which is imported only if you name it too; if you trust it, add "
            f"{key}={target!r:.200}"
        )


def code_digest(path: str) -> str:
    """Compute the SHA-256 of the source code behind a dotted path, hexadecimal.

    The code is that of the module that holds the name, and of every module of the user's own that it imports, directly
    or through others. A module is the user's own, whatever it is called, if its file lies neither in the standard
    library, nor among the installed packages (`site-packages`, `dist-packages`), nor in `ablate`. Names of modules and
    contents of files enter the digest, folders do not. An import whose name is computed when the program runs is not
    followed.

    All files of the user's folder would be a shorter rule, but then whoever edits a script beside a network could no
    longer read what he has trained.

    The files are read once for as long as the module stays loaded: a file that is edited later is not what runs. What
    cannot be loaded is a ValueError, as in `load`.
    """
    return _digest(*((module, id(module.__spec__)) for module in _holders(path)))


def _holders(path: str) -> list[ModuleType]:
    """The module that a dotted path names, and the one in which what it names was made."""
    names = (path.rpartition(".")[0], getattr(load(path), "__module__", None))
    return [sys.modules[name] for name in dict.fromkeys(names) if name in sys.modules]


@lru_cache
def _digest(*loaded: tuple[ModuleType, int]) -> str:
    """By the modules, and by their specifications, of which a module that is loaded again has a new one."""
    return _digest_of(_files(*(module for module, _ in loaded)))


def _files(*modules: ModuleType) -> dict[str, Path]:
    """The source files of modules, and of all of the user's own that they import, by name."""
    files = {module.__name__: Path(str(module.__file__)) for module in modules if getattr(module, "__file__", None)}
    to_read = list(files)
    while to_read:
        name = to_read.pop()
        for imported in _imports(name, files[name]) - files.keys():
            file = _own_file(imported)
            if file is not None:
                files[imported] = file
                to_read.append(imported)
    return files


def _digest_of(files: Mapping[str, Path]) -> str:
    """Of the names and contents of files."""
    digest = hashlib.sha256()
    for name in sorted(files):
        digest.update(name.encode() + hashlib.sha256(files[name].read_bytes()).digest())
    return digest.hexdigest()


def _imports(name: str, file: Path) -> set[str]:
    """Names that may be modules which a source file imports, with the packages that are run for them and for itself."""
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    names = {name}
    try:
        nodes = list(ast.walk(ast.parse(file.read_bytes())))
    except (SyntaxError, ValueError):  # a compiled module, or a file for another version of Python
        nodes = []
    for node in nodes:
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            with suppress(ImportError):  # a relative import that leads out of the package
                module = resolve_name("." * node.level + (node.module or ""), package)
                names.update([module, *(f"{module}.{alias.name}" for alias in node.names)])
    parts = [name.split(".") for name in names]
    return {".".join(part[:count]) for part in parts for count in range(1, len(part) + 1)}


def _own_file(name: str) -> Path | None:
    """File of a module of the user's own; None for other modules, and for a name that is no module."""
    top = name.partition(".")[0]
    try:
        if _is_installed(find_spec(top)):  # what others made is not imported to find its parts
            return None
        spec = find_spec(name)
    except (Exception, SystemExit):  # a name in a module that is no package, or a package that cannot be imported
        return None
    if spec is None or not spec.origin or not spec.has_location or _is_installed(spec):
        return None
    return Path(spec.origin)


def _is_installed(spec: ModuleSpec | None) -> bool:
    """Whether a module's file lies among the installed packages, in the standard library or in this package."""
    if spec is None or not spec.origin:
        return False
    file = Path(spec.origin)
    return bool(_INSTALLED & set(file.parts)) or any(map(file.is_relative_to, (_PACKAGE, *_OF_PYTHON)))
