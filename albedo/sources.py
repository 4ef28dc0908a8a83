"""What a result was computed by: the files that were read for it, and their contents.

The files are those of the modules that were imported, directly and through others, and the data
files that were opened, of the package and of the folder of studies. So an edit of what a study
does not use does not concern it.
"""

from __future__ import annotations

import hashlib
import os
import platform
import sys
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

PACKAGE = Path(__file__).parent
# What starts studies and shows results has no part in them.
_APART = (
    *("cli/", "templates/", "_ready.py", "runner.py", "report.py", "site.py", "ledger.py"),
    "papers.py",
)
_opened: set[str] = set()
_watching = False


def watch() -> None:
    """Note which files are opened from now on, in the whole process."""
    global _watching
    if not _watching:
        sys.addaudithook(_note)
        _watching = True


def _note(event: str, arguments: tuple[object, ...]) -> None:
    # Sources are opened to be hashed as well; those that count were imported.
    if event == "open" and isinstance(arguments[0], str) and not arguments[0].endswith(".py"):
        _opened.add(arguments[0])


def used(folder: Path) -> list[str]:
    """The files of the package and of a folder of studies that this process has read.

    Parameters
    ----------
    folder : Path
        Of studies.

    Returns
    -------
    list of str
        Paths below the package, as ``albedo/brdf.py``, and below the folder, as ``./_mine.py``,
        sorted. A package of which all modules were read is named as well, ``albedo/catalogue/``:
        one module more would be read too.
    """
    files = [getattr(module, "__file__", None) for module in list(sys.modules.values())]
    # Of some thousand files of other packages, only their few folders are looked up.
    folders: dict[str, str] = {}
    paths = set()
    for file in (*filter(None, files), *_opened):
        place, name = os.path.split(file)
        if place not in folders:
            folders[place] = os.path.realpath(place)
        paths.add(os.path.join(folders[place], name))
    roots = ((os.path.realpath(PACKAGE), "albedo/"), (os.path.realpath(folder), "./"))
    found = set()
    for root, name in roots:
        for path in (path for path in paths if path.startswith(root + os.sep)):
            below = Path(path).relative_to(root)
            apart = name == "albedo/" and below.as_posix().startswith(_APART)
            hidden = "__pycache__" in below.parts or below.suffix in (".pyc", ".so", ".pyd")
            if not apart and not hidden and os.path.isfile(path):
                found.add(name + below.as_posix())
    packages = {name.rpartition("/")[0] + "/" for name in found if name.startswith("albedo/")}
    whole = {name for name in packages if all(each in found for each in _listing(name))}
    return sorted(found | (whole - {"albedo/"}))


def digest(names: Iterable[str], folder: Path) -> str:
    """One hash of the contents of such files; of a missing one, that it is missing.

    Parameters
    ----------
    names : iterable of str
        As `used` gives them.
    folder : Path
        Of studies.

    Returns
    -------
    str
        SHA-256.
    """
    sha = hashlib.sha256()
    for name in sorted(names):
        sha.update(name.encode() + b"\0")
        if name.endswith("/"):
            sha.update("\n".join(_listing(name)).encode())
        else:
            below = name.startswith("albedo/")
            path = PACKAGE / name.removeprefix("albedo/") if below else folder / name[2:]
            sha.update(_hash(path).encode())
    return sha.hexdigest()


def versions() -> dict[str, str]:
    """Of this package and of what it computes with, and the kind of machine."""
    from importlib.metadata import version

    import albedo

    others = ("numpy", "scipy", "numba", "pandas", "matplotlib")
    return {
        "albedo": albedo.__version__,
        "python": platform.python_version(),
        **{name: version(name) for name in others},
        "machine": f"{platform.system()} {platform.machine()}",
    }


def _listing(name: str) -> list[str]:
    """All modules of a package, as paths."""
    place = PACKAGE / name.removeprefix("albedo/")
    return sorted(name + path.name for path in place.glob("*.py"))


def _hash(path: Path) -> str:
    try:
        status = path.stat()
    except FileNotFoundError:
        return "missing"
    return _hash_of(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=4096)
def _hash_of(path: Path, modified: int, size: int) -> str:
    """Once for all studies that read the file, as long as it is not written."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
