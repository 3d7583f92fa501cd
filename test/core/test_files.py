"""Files appear whole or not at all: interrupted writes, full disks, modes, and no second way to do it."""

from __future__ import annotations

import os
import re
import resource
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from hd_control.cli.main import main
from hd_control.core.errors import BagError, HdError
from hd_control.core.files import PARTIAL, whole_file, whole_folder, write_whole

ROOT = Path(__file__).resolve().parents[2]
MOVES = re.compile(r"\bos\.(replace|rename|link)\(|\.rename\(|\bmkstemp\(|\bNamedTemporaryFile\(|shutil\.move\(")
ELSEWHERE = {
    "hd_control/core/files.py": "the one place",
    "hd_control/cli/main.py": "a crash log has a new name each time and replaces nothing",
    "hd_control/demo/run.py": "moves finished recordings of the first attempt aside",
}
"""File with a move or a temporary file of its own -> why."""


@contextmanager
def full_disk(size: int) -> Iterator[None]:
    """No file of this process may grow above so many bytes: the system refuses as it does on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_text_and_bytes_arrive_with_the_mode_of_any_new_file(tmp_path: Path) -> None:
    path = tmp_path / "a"
    write_whole(path, "µ\r\n")
    assert path.read_bytes() == "µ\r\n".encode()
    write_whole(str(path), b"\x00\xff")
    assert path.read_bytes() == b"\x00\xff"
    (tmp_path / "plain").touch()
    assert mode(path) == mode(tmp_path / "plain"), "as the umask wants it"


def test_the_mode_of_a_replaced_file_stays(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.touch(0o640)
    path.chmod(0o604)
    write_whole(path, "new")
    assert path.read_text() == "new" and mode(path) == 0o604


@pytest.mark.parametrize("reason", [KeyboardInterrupt, ValueError, SystemExit])
def test_what_ends_early_leaves_the_old_file_and_nothing_else(tmp_path: Path, reason: type[BaseException]) -> None:
    path = tmp_path / "a"
    path.write_text("old")
    with pytest.raises(reason), whole_file(path) as place:
        place.write_text("half")
        raise reason
    assert path.read_text() == "old" and [*tmp_path.iterdir()] == [path]
    with pytest.raises(reason), whole_file(tmp_path / "new"):
        raise reason
    assert [*tmp_path.iterdir()] == [path]


def test_a_killed_process_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_text("old")
    code = (
        "import sys, time\nfrom pathlib import Path\nfrom hd_control.core.files import whole_file\n"
        "with whole_file(sys.argv[1]) as place:\n    place.write_text('half')\n    time.sleep(60)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code, str(path)], cwd=ROOT)
    end = time.monotonic() + 30.0  # a loaded machine starts a process slowly
    while not [*tmp_path.glob(f".a.*{PARTIAL}")] and time.monotonic() < end:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    assert process.wait(30.0) == -signal.SIGKILL
    assert path.read_text() == "old" and len([*tmp_path.glob(f".a.*{PARTIAL}")]) == 1
    write_whole(path, "new")
    assert path.read_text() == "new", "what a killed process left is in nobody's way"


def test_a_full_disk_is_one_clear_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a"
    path.write_text("old")
    with full_disk(100), pytest.raises(BagError, match=f"^{path}: cannot be written .*; the file size limit"):
        write_whole(path, "x" * 1000, BagError)
    assert path.read_text() == "old" and [*tmp_path.iterdir()] == [path]
    with full_disk(100):
        code = main(["completion", "bash", "--json", str(path), "--force", "--quiet"])
    error = capsys.readouterr().err
    assert code == 2 and error.count("\n") == 1 and error.startswith(f"hd: {path}: cannot be written"), error
    assert path.read_text() == "old" and [*tmp_path.iterdir()] == [path]


def test_each_refusal_names_the_path_and_a_remedy(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for path, says in (
        (tmp_path / "no" / "a", "make it first"),
        (tmp_path / "file" / "a", "part of the path is a file"),
        (tmp_path, "it is a folder"),
        (tmp_path / ("a" * 300), "choose another place"),
    ):
        with pytest.raises(HdError, match=f"^{re.escape(str(path))}: cannot be written .*{says}"):
            write_whole(path, "")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_a_device_or_pipe_is_never_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(HdError, match="not an ordinary file"):
        write_whole(tmp_path / "pipe", "x")
    assert (tmp_path / "pipe").is_fifo()


def test_errors_of_other_files_are_not_called_write_errors(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="source"), whole_file(tmp_path / "a"):
        (tmp_path / "source").read_text()
    assert not [*tmp_path.iterdir()]


def test_a_folder_appears_whole(tmp_path: Path) -> None:
    path, asked = tmp_path / "bag", []
    with whole_folder(path, lambda: asked.append(path.exists())) as place:
        place.mkdir()
        (place / "a").write_text("new")
        assert not path.exists()
    assert (path / "a").read_text() == "new" and asked == [False] and [*tmp_path.iterdir()] == [path]


def test_a_folder_that_ends_early_or_is_refused_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    path.mkdir()
    (path / "a").write_text("old")

    def refuse() -> None:
        raise BagError("exists")

    for make_room, end in ((refuse, None), (lambda: None, KeyboardInterrupt), (lambda: None, None)):
        with pytest.raises((BagError, KeyboardInterrupt)), whole_folder(path, make_room, BagError) as place:
            place.mkdir()
            (place / "b").touch()
            if end is not None:
                raise end
        assert (path / "a").read_text() == "old" and [*tmp_path.iterdir()] == [path]
    with pytest.raises(BagError, match="make it first"), whole_folder(tmp_path / "no" / "bag", refuse, BagError):
        pass


def movers(folder: Path) -> set[str]:
    """Files of the two packages below a folder that make temporary files or move files themselves."""
    paths = [path for name in ("hd_control", "hd_sim") for path in (folder / name).rglob("*.py")]
    return {str(path.relative_to(folder)) for path in paths if MOVES.search(path.read_text())}


def test_there_is_one_way_to_write_whole_files(tmp_path: Path) -> None:
    assert movers(ROOT) == set(ELSEWHERE)
    (tmp_path / "hd_sim").mkdir()
    (tmp_path / "hd_sim" / "own.py").write_text("os.replace(partial, path)\n")
    assert movers(tmp_path) == {"hd_sim/own.py"}
