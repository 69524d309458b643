"""Files are written completely or not at all: through links, on full disks, under signals."""

import json
import os
import re
import signal
import stat
import subprocess
import sys

import pytest
from helpers.problem_files import COTTON

import plough_opt as po
from plough_opt.core.files import write_file, write_files, write_folder, write_new


def _kept(folder):
    """Return the files in a folder: name -> text."""
    return {path.name: path.read_text() for path in folder.iterdir()}


def test_text_bytes_and_a_writer_come_out_alike(tmp_path):
    for name, content in (("a", "é\n"), ("b", "é\n".encode()), ("c", lambda file: file.write("é\n".encode()))):
        assert write_file(tmp_path / "new" / name, "table", content) == tmp_path / "new" / name
    assert {path.read_bytes() for path in (tmp_path / "new").iterdir()} == {b"\xc3\xa9\n"}


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, SystemExit, OSError(28, "No space left on device")])
def test_an_interrupted_write_leaves_the_existing_file(tmp_path, error):
    def half(file):
        file.write(b"half of")
        raise error

    (tmp_path / "a").write_text("before")
    (tmp_path / "link").symlink_to("a")
    full = isinstance(error, OSError)
    for name in ("a", "b", "link"):
        words = rf"the table '.*{name}' cannot be written: no space left on device" if full else None
        with pytest.raises(po.InputError if full else error, match=words):
            write_file(tmp_path / name, "table", half)
    assert _kept(tmp_path) == {"a": "before", "link": "before"}


def test_links_are_followed_and_stay(tmp_path):
    (tmp_path / "far").mkdir()
    (tmp_path / "far" / "a").write_text("before")
    (tmp_path / "link").symlink_to("far/a")
    (tmp_path / "to nothing").symlink_to("far/b")
    (tmp_path / "twice").symlink_to("link")
    for name in ("link", "twice", "to nothing"):
        write_file(tmp_path / name, "table", name)
        assert (tmp_path / name).is_symlink()
    assert _kept(tmp_path / "far") == {"a": "twice", "b": "to nothing"}


def test_permissions_are_preserved_and_new_files_have_the_usual_ones(tmp_path):
    before = os.umask(0o027)
    try:
        write_file(tmp_path / "a", "table", "one")
        assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640
        (tmp_path / "a").chmod(0o604)
        write_file(tmp_path / "a", "table", "two")
        assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o604
        write_folder(tmp_path / "made", "folder", {"x": "one"})
        assert stat.S_IMODE((tmp_path / "made").stat().st_mode) == 0o750
    finally:
        os.umask(before)


def test_paths_that_cannot_be_written_are_refused(tmp_path, monkeypatch):
    # What the system tells users other than root of a file without the permission to write.
    monkeypatch.setattr(os, "access", lambda path, mode: not (path.name == "a" and mode == os.W_OK))
    (tmp_path / "a").write_text("before")
    (tmp_path / "round").symlink_to("round")
    reasons = {"": "folder", "round": "in a circle", "x" * 300: "too long", "a": "permission denied",
               "/dev/full": "no space left on device"}  # fmt: skip
    for name, why in reasons.items():
        with pytest.raises(po.InputError, match=rf"the table '.*' cannot be written: .*({why})"):
            write_file(tmp_path / name, "table", "after")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "round"]
    assert (tmp_path / "a").read_text() == "before"


def test_a_pipe_is_written_to(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    reader = subprocess.Popen(["cat", tmp_path / "pipe"], stdout=subprocess.PIPE)
    write_file(tmp_path / "pipe", "table", "through")
    assert reader.communicate()[0] == b"through"
    assert (tmp_path / "pipe").is_fifo()


def test_of_several_none_is_moved_before_all_are_written(tmp_path):
    (tmp_path / "a").write_text("before")
    with pytest.raises(po.InputError, match=r"'.*a/b' cannot be written: .*is not a folder"):
        write_files({tmp_path / "a": "after", tmp_path / "a" / "b": "after"}, "table")
    assert _kept(tmp_path) == {"a": "before"}


def test_a_new_file_is_written_once(tmp_path):
    write_new(tmp_path / "a", "problem file", "one")
    (tmp_path / "link").symlink_to("nothing")
    for name in ("a", "link"):
        with pytest.raises(po.InputError, match="exists already and is left as it is"):
            write_new(tmp_path / name, "problem file", "two")
    assert (tmp_path / "a").read_text() == "one"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "link"]


QUICK = ("--set", "scene.duration=0.05 s", "--set", "scene.outputs=10")


# A program that waits in the middle of a file until a signal terminates it.
SLOW = """
import sys, time
from pathlib import Path
from plough_opt.core.files import write_file, write_folder
def slow(file):
    file.write(b"half of")
    file.flush()
    print("writing", flush=True)
    time.sleep(60.0)
if sys.argv[1] == "folder":
    write_folder(Path(sys.argv[2]), "folder", {"whole": "one", "half": slow})
write_file(sys.argv[2], "table", slow)
"""


@pytest.mark.usefixtures("ctrl_c")
@pytest.mark.parametrize(
    ("kind", "number"), [("file", signal.SIGTERM), ("folder", signal.SIGHUP), ("file", signal.SIGINT)]
)
def test_a_signal_that_ends_the_process_leaves_nothing_behind(tmp_path, kind, number):
    line = [sys.executable, "-c", SLOW, kind, str(tmp_path / "a")]
    process = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout.readline() == b"writing\n"
    process.send_signal(number)
    process.communicate()
    assert process.returncode == -number
    assert list(tmp_path.iterdir()) == []


def test_json_is_the_same_whatever_the_streams_encoding(tmp_path):
    title = 'Grubber für Шымкент, ≤ 40 \N{TRACTOR} "quoted"'
    path = tmp_path / "p.toml"
    path.write_text(re.sub("^title = .*", f"title = '{title}'", COTTON, flags=re.MULTILINE), encoding="utf-8")
    line = [sys.executable, "-m", "plough_opt", "simulate", str(path), *QUICK, "--json"]
    done = subprocess.run(line, capture_output=True, check=True, env=os.environ | {"PYTHONIOENCODING": "ascii"})
    assert json.loads(done.stdout.decode("ascii"))["title"] == title
