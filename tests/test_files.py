"""Files are written completely or not at all: through links, on full disks, under signals."""

import json
import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import pytest

import plough_opt as po
from plough_opt.app import main
from plough_opt.core.files import write_file, write_files, write_folder, write_new

PROBLEMS = Path(__file__).parents[1] / "problems"


def _kept(folder):
    """Return the files in a folder: name -> text."""
    return {path.name: path.read_text() for path in folder.iterdir()}


class TestAFile:
    def test_text_bytes_and_a_writer_come_out_alike(self, tmp_path):
        for name, content in (("a", "é\n"), ("b", "é\n".encode()), ("c", lambda file: file.write("é\n".encode()))):
            assert write_file(tmp_path / "new" / name, "table", content) == tmp_path / "new" / name
        assert {path.read_bytes() for path in (tmp_path / "new").iterdir()} == {b"\xc3\xa9\n"}

    @pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, SystemExit])
    def test_an_interrupted_write_leaves_the_existing_file(self, tmp_path, error):
        def half(file):
            file.write(b"half of")
            raise error

        (tmp_path / "a").write_text("before")
        with pytest.raises(error):
            write_file(tmp_path / "a", "table", half)
        with pytest.raises(error):
            write_file(tmp_path / "b", "table", half)
        assert _kept(tmp_path) == {"a": "before"}

    def test_links_are_followed_and_stay(self, tmp_path):
        (tmp_path / "far").mkdir()
        (tmp_path / "far" / "a").write_text("before")
        (tmp_path / "link").symlink_to("far/a")
        (tmp_path / "to nothing").symlink_to("far/b")
        (tmp_path / "twice").symlink_to("link")
        for name in ("link", "twice", "to nothing"):
            write_file(tmp_path / name, "table", name)
            assert (tmp_path / name).is_symlink()
        assert _kept(tmp_path / "far") == {"a": "twice", "b": "to nothing"}

    def test_a_failure_leaves_what_a_link_leads_to(self, tmp_path):
        (tmp_path / "a").write_text("before")
        (tmp_path / "link").symlink_to("a")

        def full(file):
            file.write(b"half of")
            raise OSError(28, "No space left on device")

        with pytest.raises(po.InputError, match=r"the table '.*link' cannot be written: no space left on device"):
            write_file(tmp_path / "link", "table", full)
        assert _kept(tmp_path) == {"a": "before", "link": "before"}

    def test_permissions_are_preserved_and_new_files_have_the_usual_ones(self, tmp_path):
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

    def test_invalid_paths_are_refused(self, tmp_path):
        (tmp_path / "a").write_text("before")
        (tmp_path / "round").symlink_to("round")
        wrong = {"": "folder", "a/b": "is not a folder", "round": "in a circle", "x" * 300: "too long"}
        for name, why in wrong.items():
            with pytest.raises(po.InputError, match=rf"the table '.*' cannot be written: .*({why})"):
                write_file(tmp_path / name, "table", "after")
        assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "round"]
        assert (tmp_path / "a").read_text() == "before"

    def test_a_pipe_is_written_to(self, tmp_path):
        os.mkfifo(tmp_path / "pipe")
        reader = subprocess.Popen(["cat", tmp_path / "pipe"], stdout=subprocess.PIPE)
        write_file(tmp_path / "pipe", "table", "through")
        assert reader.communicate()[0] == b"through"
        assert (tmp_path / "pipe").is_fifo()

    def test_a_full_device_is_an_error(self):
        with pytest.raises(po.InputError, match="no space left on device"):
            write_file("/dev/full", "table", "anything")

    def test_of_several_none_is_moved_before_all_are_written(self, tmp_path):
        (tmp_path / "a").write_text("before")
        with pytest.raises(po.InputError, match=r"'.*a/b' cannot be written"):
            write_files({tmp_path / "a": "after", tmp_path / "a" / "b": "after"}, "table")
        assert _kept(tmp_path) == {"a": "before"}


class TestANewFile:
    def test_is_written_once(self, tmp_path):
        write_new(tmp_path / "a", "problem file", "one")
        (tmp_path / "link").symlink_to("nothing")
        for name in ("a", "link"):
            with pytest.raises(po.InputError, match="exists already and is left as it is"):
                write_new(tmp_path / name, "problem file", "two")
        assert (tmp_path / "a").read_text() == "one"
        assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "link"]


# A program that may write at most 1,000 bytes to a file, to simulate a full disk.
FULL = """
import resource, sys
from plough_opt.app import main
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
sys.exit(main(sys.argv[1:]))
"""
QUICK = ("--set", "scene.duration=0.05 s", "--set", "scene.outputs=10")


@pytest.mark.parametrize(
    ("line", "name"),
    [
        (("init",), "a.toml"),
        pytest.param(
            ("simulate", PROBLEMS / "cotton_subsoiler.toml", *QUICK, "--plot"), "link.svg", marks=pytest.mark.slow
        ),
    ],
    ids=["init", "plot through a link"],
)
def test_a_full_disk_leaves_nothing_new(tmp_path, line, name):
    (tmp_path / "link.svg").symlink_to("picture.svg")
    (tmp_path / "picture.svg").write_text("before")
    code = [sys.executable, "-c", FULL, *map(str, line), str(tmp_path / name)]
    environment = os.environ | {"MPLCONFIGDIR": os.environ.get("MPLCONFIGDIR", str(Path.home() / ".config/matplotlib"))}
    done = subprocess.run(code, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 2, done.stderr
    assert "cannot be written: file too large" in done.stderr
    assert _kept(tmp_path) == {"link.svg": "before", "picture.svg": "before"}
    assert main(["init", str(tmp_path / "a.toml")]) == 0  # which finds no stub of the failure


# A program that waits in the middle of a file until a signal terminates it.
SLOW = """
import sys, time
from plough_opt.core.files import write_file, write_folder
def slow(file):
    file.write(b"half of")
    file.flush()
    print("writing", flush=True)
    time.sleep(60.0)
if sys.argv[1] == "folder":
    from pathlib import Path
    write_folder(Path(sys.argv[2]), "folder", {"whole": "one", "half": slow})
write_file(sys.argv[2], "table", slow)
"""


@pytest.mark.parametrize(
    ("kind", "number"),
    [
        *(("file", signal.SIGTERM), ("folder", signal.SIGHUP), ("file", signal.SIGINT)),
        *(pytest.param(kind, number, marks=pytest.mark.slow)
          for kind, number in (("folder", signal.SIGTERM), ("file", signal.SIGHUP), ("folder", signal.SIGINT))),
    ],
)  # fmt: skip
def test_a_signal_that_ends_the_process_leaves_nothing_behind(tmp_path, kind, number):
    line = ["sh", "-c", 'trap - INT; exec "$0" "$@"', sys.executable, "-c", SLOW, kind, str(tmp_path / "a")]
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's & may have it ignored
    try:
        process = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    finally:
        signal.signal(signal.SIGINT, before)
    assert process.stdout.readline() == b"writing\n"
    process.send_signal(number)
    process.communicate()
    assert process.returncode == -number
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("encoding", ["ascii", *(pytest.param(x, marks=pytest.mark.slow) for x in ("cp1252", "utf-8"))])
def test_json_is_the_same_whatever_the_streams_encoding(tmp_path, encoding):
    title = 'Grubber für Шымкент, ≤ 40 \N{TRACTOR} "quoted"'
    text = (PROBLEMS / "cotton_subsoiler.toml").read_text(encoding="utf-8")
    path = tmp_path / "p.toml"
    path.write_text(text.replace(text[text.index("title") : text.index("\n")], f"title = '{title}'"), encoding="utf-8")
    line = [sys.executable, "-m", "plough_opt", "simulate", str(path), *QUICK, "--json"]
    done = subprocess.run(line, capture_output=True, check=True, env=os.environ | {"PYTHONIOENCODING": encoding})
    assert json.loads(done.stdout.decode("ascii"))["title"] == title
