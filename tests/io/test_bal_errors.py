"""Everything that can be wrong with a BAL file, and what is said about it."""

import bz2
import os
import signal
import threading
from pathlib import Path

import pytest

import bundle
from bundle.io import bal
from tests.io.bal_files import bal_text, gzip_bytes, load_bytes, make_bal
from tests.io.mutations import load_all


@pytest.mark.parametrize(("compress", "format"), [(gzip_bytes, "gzip"), (bz2.compress, "bzip2")])
def test_damaged_compression(tmp_path: Path, compress, format: str) -> None:
    data = compress(bal_text(*make_bal(10, num_points=500)))
    truncated = "expected more data, found the end of the file"
    half = len(data) // 2
    with pytest.raises(bundle.InputError) as error:
        load_bytes(tmp_path, data[:half])
    path = tmp_path / "problem.txt"
    assert str(error.value) == f"{path}: {format} data at byte {half}: {truncated}"
    for end in (1, 3, 7):
        with pytest.raises(bundle.InputError, match=truncated):
            load_bytes(tmp_path, data[:-end])
    with pytest.raises(bundle.InputError, match=f"byte {len(data) + 9}: {truncated}"):
        load_bytes(tmp_path, data + data[:9])
    with pytest.raises(bundle.InputError, match="expected another stream or the end of the file"):
        load_bytes(tmp_path, data + b"junk")


@pytest.mark.parametrize("position", [-8, -5])
@pytest.mark.parametrize("compress", [gzip_bytes, bz2.compress])
def test_checksums_are_looked_at(tmp_path: Path, compress, position: int) -> None:
    """The damage stands behind the last number."""
    data = bytearray(compress(bal_text(*make_bal(11))))
    data[position] ^= 0x10
    with pytest.raises(bundle.InputError, match="expected intact data, found damage"):
        load_bytes(tmp_path, bytes(data))


CAMERA = "0 0 0 0 0 0 500 0 0\n"
COUNT = "(0 to 2147483647), found"
NUMBER = "(a finite number), found"
FIRST = "observation 0 (0 to 0), found"
POSITIVE = "(a finite number above 0), found"
BAD_FILES = {
    "": f"1: expected the number of cameras {COUNT} the end of the file",
    " \n\n ": f"3: expected the number of cameras {COUNT} the end of the file",
    "x": f"1: expected the number of cameras {COUNT} 'x'",
    "-1 0 0": f"1: expected the number of cameras {COUNT} '-1'",
    "1 1.0 0": f"1: expected the number of points {COUNT} '1.0'",
    "1 1 2147483648": f"1: expected the number of observations {COUNT} '2147483648'",
    "1 1 1": "1: expected at least 37 bytes for the cameras, points and observations counted here, "
    "found a file of 5 bytes",
    f"1 1 1\n1 0 0 0\n{CAMERA}1 2 3": f"2: expected the camera of {FIRST} '1'",
    f"1 1 1\n0 -1 0 0\n{CAMERA}1 2 3": f"2: expected the point of {FIRST} '-1'",
    "0 1 1\n0 0 0 0\n1 2 3        ": "2: expected the camera of observation 0 "
    "(but there is no camera), found '0'",
    f"1 1 1\n0 0 nan 0\n{CAMERA}1 2 3": f"2: expected x of observation 0 {NUMBER} 'nan'",
    f"1 1 1\n0 0 0 -inf\n{CAMERA}1 2 3": f"2: expected y of observation 0 {NUMBER} '-inf'",
    "1 0 0\n0 0 0 0 0 0 0 0 0": f"2: expected the focal length of camera 0 {POSITIVE} '0'",
    "1 0 0\n0 0 0 0 0 0\n-2 0 0": f"3: expected the focal length of camera 0 {POSITIVE} '-2'",
    "1 0 0\n0 1e200 0 0 0 0 1 0 0": "2: expected the rotation of camera 0 (a number below 1e100), "
    "found '1e200'",
    "1 0 0\n0 0 0 0 1e999 0 1 0 0": f"2: expected the translation of camera 0 {NUMBER} '1e999'",
    "1 0 0\n0 0 0 0 0 0 1 0x1 0": f"2: expected k1 of camera 0 {NUMBER} '0x1'",
    "1 0 0\n0 0 0 0 0 0 1 0 +-1": f"2: expected k2 of camera 0 {NUMBER} '+-1'",
    "0 2 0\n1 2 3\n1 2         ": f"3: expected Z of point 1 {NUMBER} the end of the file",
    "0 1 0\n1 2 1,5": f"2: expected Z of point 0 {NUMBER} '1,5'",
    "0 1 0\n1 2 3\n\n7": "4: expected the end of the file, found '7'",
    "0 1 0\n1 2 " + "9" * 5000: f"2: expected Z of point 0 {NUMBER} '{'9' * 40}...'",
    "0 1 0\n1 2 " + "A" * 3_000_000: f"2: expected Z of point 0 {NUMBER} '{'A' * 40}...'",
    "0 1 0\n1 2 \x00\x1b[31m\x7f": rf"2: expected Z of point 0 {NUMBER} '\x00\x1b[31m\x7f'",
    "0 1 0\n1 2 é\u2028": f"2: expected Z of point 0 {NUMBER} 'é\\xe2\\x80\\xa8'",
}


@pytest.mark.parametrize(("text", "message"), BAD_FILES.items(), ids=range(len(BAD_FILES)))
def test_messages(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "problem.txt"
    path.write_bytes(text.encode())
    with pytest.raises(bundle.InputError) as error:
        bundle.load(path)
    assert str(error.value) == f"{path}:{message}"


def test_bytes_that_are_no_utf8_are_escaped(tmp_path: Path) -> None:
    with pytest.raises(bundle.InputError, match=r"found '\\xff\\xfe\\xc0\\x80\\xed\\xa0\\x80'"):
        load_bytes(tmp_path, b"\xff\xfe\xc0\x80\xed\xa0\x80")
    odd = tmp_path / "a\nb\udcff.txt"
    odd.write_text("x")
    with pytest.raises(bundle.InputError, match=r"a\\x0ab\\xff\.txt:1: expected"):
        bundle.load(odd)


@pytest.mark.parametrize("pad", [b"", b" " * 100_000])
def test_large_counts_take_no_memory(tmp_path: Path, pad: bytes) -> None:
    text = b"2147483647 2147483647 2147483647\n" + pad
    paths = []
    for name, data in {"a": text, "b": gzip_bytes(text), "c": bz2.compress(text)}.items():
        paths.append(tmp_path / name)
        paths[-1].write_bytes(data)
    outcomes = load_all(paths)  # in 6 GB of address space
    assert [outcome.kind for outcome in outcomes] == ["InputError"] * 3
    assert "expected at least" in outcomes[0].message
    assert "expected the camera of observation 0" in outcomes[1].message


def test_what_the_system_refuses_stays_an_os_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as missing:
        bundle.load(tmp_path / "missing")
    assert str(missing.value) == f"[Errno 2] No such file or directory: '{tmp_path}/missing'"
    problem = load_bytes(tmp_path, bal_text(*make_bal(12)))
    with pytest.raises(OSError, match="No space left on device"):
        bal.save(problem, Path("/dev/full"))
    with pytest.raises(OSError, match="No space left on device"):
        bal.save(problem, Path("/dev/full"), "bzip2")


def test_a_signal_ends_the_reading(tmp_path: Path) -> None:
    """Python's signal handlers run, and may raise, while C++ reads a pipe that never ends."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)

    def write_blanks() -> None:
        with open(pipe, "wb", buffering=0) as file:  # noqa: PTH123
            try:
                while True:
                    file.write(b" \n" * 32_768)
            except BrokenPipeError:
                pass

    def give_up(*_: object) -> None:
        raise TimeoutError("enough")

    thread = threading.Thread(target=write_blanks)
    previous = signal.signal(signal.SIGALRM, give_up)
    thread.start()
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.2)
        with pytest.raises(TimeoutError, match="enough"):
            bundle.load(pipe)
    finally:
        signal.signal(signal.SIGALRM, previous)
        thread.join()
