"""Files of the C++ core follow classes: one header per source, and each declaration once."""

import re
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CORE = ROOT / "cpp" / "core"
SOURCES = sorted(path for path in CORE.rglob("*.cpp") if path.name != "kernels.cpp")
FILES = sorted(path for path in (ROOT / "cpp").rglob("*") if path.suffix in {".h", ".cpp"})
LONGEST = 350


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.relative_to(CORE).as_posix())
def test_a_source_has_a_header_or_names_its_class(path: Path) -> None:
    first = path.read_text().partition("\n")[0]
    header = path.with_suffix(".h")
    if header.exists():
        assert first == f'#include "{header.relative_to(ROOT / "cpp").as_posix()}"'
        return
    named = re.match(r"/// Part of (?:\w+ \((\w+\.h)\)|(\w+\.h)): \S", first)
    assert named, "expected '/// Part of CLASS (header.h): CONTENTS' in the first line"
    assert (path.parent / (named[1] or named[2])).exists()


def test_no_file_is_too_long() -> None:
    lengths = {path.name: path.read_text().count("\n") for path in FILES}
    assert {name: count for name, count in lengths.items() if count > LONGEST} == {}


def test_constants_are_declared_once() -> None:
    constant = re.compile(r"^inline constexpr [\w:<>]+ (k\w+)", re.MULTILINE)
    headers = [path for path in FILES if path.suffix == ".h"]
    declared = Counter(name for path in headers for name in constant.findall(path.read_text()))
    assert [name for name, count in declared.items() if count > 1] == []


def test_comments_of_members_begin_with_a_noun() -> None:
    found = [path.name for path in FILES if re.search(r"///< [Oo]f\b", path.read_text())]
    assert found == []
