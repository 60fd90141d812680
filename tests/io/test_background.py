"""An output is completed on a thread, in the order of any output, while the caller goes on."""

import errno
import os
import signal
import threading
from pathlib import Path

import pytest

from bundle.io.atomic import atomic_write as atomic
from bundle.io.atomic import background
from bundle.io.atomic.background import completing_in_background
from bundle.io.atomic.replaced_paths import recording
from tests.io.kills import killed_before
from tests.io.trees import NEW_MODEL, OLD_MODEL, tree, write_tree

WAIT = 30.0
"""Seconds until a test gives up."""


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Return an event for which every fsync waits."""
    done = threading.Event()

    def fsync(_: int) -> None:
        assert done.wait(WAIT)

    monkeypatch.setattr(os, "fsync", fsync)
    return done


def write_model(path: Path, content: dict[str, str] = NEW_MODEL) -> None:
    with atomic.replace_folder(path) as temporary:
        write_tree(temporary, content)


def in_model(content: dict[str, str]) -> dict[str, str]:
    return {f"model/{name}": text for name, text in content.items()}


@pytest.mark.parametrize("exists", [False, True])
def test_the_caller_goes_on_and_the_block_waits(tmp_path, disk, exists) -> None:
    before = in_model(OLD_MODEL) if exists else {}
    write_tree(tmp_path, before)
    with recording() as written, completing_in_background() as output:
        write_model(tmp_path / "model")
        seen = {k: v for k, v in tree(tmp_path).items() if not k.startswith(".bundle-")}
        assert (seen, written) == (before, [])
        disk.set()
    assert tree(tmp_path) == in_model(NEW_MODEL)
    assert written == [tmp_path / "model"]
    assert output.waited > 0


def test_an_output_waits_for_the_one_before(tmp_path, disk) -> None:
    """The second goes into the folder that the first makes."""
    threading.Timer(0.1, disk.set).start()
    with completing_in_background():
        write_model(tmp_path / "model")
        atomic.write_text(tmp_path / "model" / "beside.json", "{}")
    assert tree(tmp_path) == in_model(NEW_MODEL | {"beside.json": "{}"})


def test_a_model_may_go_into_the_folder_of_the_one_before(tmp_path, disk) -> None:
    threading.Timer(0.1, disk.set).start()
    with completing_in_background():
        write_model(tmp_path / "model")
        write_model(tmp_path / "model" / "inner")
    inner = {f"inner/{name}": text for name, text in NEW_MODEL.items()}
    assert tree(tmp_path) == in_model(NEW_MODEL | inner)


def test_an_output_after_a_failed_one_is_completed(tmp_path, monkeypatch) -> None:
    def fsync(_: int) -> None:
        raise OSError(errno.EIO, "cannot flush")

    with completing_in_background():
        with monkeypatch.context() as patched:
            patched.setattr(os, "fsync", fsync)
            write_model(tmp_path / "failed")
            with pytest.raises(OSError, match="cannot flush"):
                background.wait_for_output()
        write_model(tmp_path / "model")
    assert tree(tmp_path) == in_model(NEW_MODEL)


def test_outputs_in_each_other_are_all_completed(tmp_path) -> None:
    with completing_in_background(), atomic.replace_file(tmp_path / "outer") as outer:
        outer.write_text("1")
        atomic.write_text(tmp_path / "inner", "2")
        write_model(tmp_path / "model")
    assert tree(tmp_path) == {"outer": "1", "inner": "2"} | in_model(NEW_MODEL)


def test_outside_of_a_block_nothing_is_deferred(tmp_path) -> None:
    with completing_in_background():
        pass
    threads = threading.active_count()
    write_model(tmp_path / "model")
    assert tree(tmp_path) == in_model(NEW_MODEL)
    assert threading.active_count() == threads


def test_other_threads_do_not_take_part(tmp_path, disk) -> None:
    disk.set()
    with completing_in_background() as output:
        thread = threading.Thread(target=write_model, args=(tmp_path / "model",))
        thread.start()
        thread.join()
        assert output.waited == 0
        assert tree(tmp_path) == in_model(NEW_MODEL)


def test_an_error_of_the_block_does_not_cancel_the_output(tmp_path, disk) -> None:
    with pytest.raises(ZeroDivisionError), completing_in_background():
        write_model(tmp_path / "model")
        threading.Timer(0.1, disk.set).start()
        raise ZeroDivisionError
    assert tree(tmp_path) == in_model(NEW_MODEL)


def test_an_interruption_of_the_wait_does_not_cancel_the_output(tmp_path, disk) -> None:
    def interrupt() -> None:
        os.kill(os.getpid(), signal.SIGINT)
        threading.Timer(1.0, disk.set).start()  # long after the block would end without waiting

    with pytest.raises(KeyboardInterrupt), recording() as written, completing_in_background():
        write_model(tmp_path / "model")
        threading.Timer(0.1, interrupt).start()
    assert tree(tmp_path) == in_model(NEW_MODEL)
    assert written == [tmp_path / "model"]


@pytest.mark.parametrize("later", [None, ZeroDivisionError, "other"])
def test_a_failure_is_raised_once_and_leaves_what_was_there(tmp_path, monkeypatch, later) -> None:
    def fsync(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    write_tree(tmp_path, in_model(OLD_MODEL))
    monkeypatch.setattr(os, "fsync", fsync)
    with (
        recording() as written,
        pytest.raises(OSError, match="No space left on device") as failure,
        completing_in_background(),
    ):
        write_model(tmp_path / "model")
        if later == "other":
            write_model(tmp_path / "other")
        elif later is not None:
            raise later
    assert failure.value.filename == str(tmp_path / "model")
    assert tree(tmp_path) == in_model(OLD_MODEL)
    assert written == []


def test_without_threads_the_caller_completes_the_output(tmp_path, monkeypatch) -> None:
    def start(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", start)
    with completing_in_background() as output:
        write_model(tmp_path / "model")
        assert tree(tmp_path) == in_model(NEW_MODEL)
    assert output.waited == 0


def test_killed_at_any_moment_it_leaves_the_old_or_the_new(tmp_path) -> None:
    def work() -> None:
        with completing_in_background():
            write_model(tmp_path / "model")

    write_tree(tmp_path, in_model(OLD_MODEL))
    seen = []
    for operation in range(300):
        if not killed_before(operation, work):
            break
        found = tree(tmp_path / "model")
        seen.append(found)
        assert found in (OLD_MODEL, NEW_MODEL)
        write_model(tmp_path / "model", OLD_MODEL)
    assert operation > 20
    assert seen[0] == OLD_MODEL
    assert seen[-1] == NEW_MODEL


def test_the_context_is_left_at_the_end() -> None:
    with pytest.raises(ZeroDivisionError), completing_in_background():
        raise ZeroDivisionError
    assert background._current.get() is None
