"""Files are whole or as they were, jobs hold what they write, and digests follow the code alone."""

import errno
import os
import pickle
import subprocess
import sys
import time
from pathlib import Path

import numba
import pytest
from filelock import FileLock
from hypothesis import given
from hypothesis import strategies as st
from numba.core.errors import TypingError

from estimators.tuned import Tuned, Tuning, to_toml
from quadsim.config.toml import parse, read_toml
from quadsim.runs import compiled
from quadsim.runs.compiled import njit
from quadsim.runs.console import progress_bar
from quadsim.runs.files import alone, replace, write_csv, write_whole
from quadsim.runs.fingerprint import code_digest, fingerprint, read_source
from quadsim.runs.record import load_record, recorded


def test_a_progress_bar_ends_full(capsys):
    with progress_bar("evaluate", "runs") as bar:
        bar(2, 3, "mahony")
    assert "3/3 runs" in capsys.readouterr().err


def full_disk(part: Path) -> None:
    """Write half a file, and find the disk full."""
    part.write_bytes(b"half")
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_file_is_whole_or_as_it_was(tmp_path):
    path = write_whole(tmp_path / "deep" / "x.txt", "before °")
    with pytest.raises(OSError, match=r"x\.txt") as caught:
        replace(path, full_disk)
    assert caught.value.errno == errno.ENOSPC
    assert path.read_text("utf-8") == "before °"
    assert os.listdir(path.parent) == ["x.txt"]
    write_whole(path, b"after")
    assert path.read_bytes() == b"after"


def test_a_folder_that_is_a_file_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(NotADirectoryError, match="Not a directory"):
        write_whole(tmp_path / "file" / "x", "")


def test_rows_are_written_under_the_union_of_their_keys(tmp_path):
    path = write_csv(tmp_path / "x.csv", [{"a": 0.1, "b": "x,y"}, {"a": 2, "c": None}])
    assert path.read_text() == 'a,b,c\n0.1,"x,y",\n2,,\n'


def test_a_process_that_holds_a_folder_may_hold_it_again_until_it_gives_it_up(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lock = tmp_path / ".x.lock"
    with alone(tmp_path / "x"):
        with alone(Path("x")):
            pass
        assert lock.exists()
    assert not lock.exists()


def test_a_folder_is_held_from_inside_where_the_one_around_it_cannot_be_written(tmp_path, monkeypatch):
    folder = tmp_path / "x"
    folder.mkdir()

    class OnlyBelow(FileLock):
        def acquire(self, *arguments, **options):
            if Path(self.lock_file).parent != folder:
                raise PermissionError(13, "Permission denied", self.lock_file)
            return super().acquire(*arguments, **options)

    monkeypatch.setattr("filelock.FileLock", OnlyBelow)
    with alone(folder):
        assert [each.name for each in folder.iterdir()] == [".x.lock"]
    assert not list(folder.iterdir())


def test_digest_follows_the_code_and_not_its_comments():
    before = read_source('def f(x):\n    """Doc."""\n    return x + 1\n').digest
    assert read_source("def f(x):  # a comment\n    return (x +\n            1)\n").digest == before
    assert read_source("def f(x):\n    return x + 2\n").digest != before
    assert code_digest("quadsim.flight") != code_digest("quadsim.flight", "training.epochs")
    assert fingerprint({"a": 1, "b": [2.5]}) == fingerprint({"b": [2.5], "a": 1})


@given(comment=st.text(), command=st.text(), value=st.floats(-1e9, 1e9))
def test_tuned_parameters_are_read_back_whatever_the_text_beside_them(comment, command, value):
    if any(0xD800 <= ord(each) < 0xE000 for each in comment + command):
        return  # half a character, which no file in UTF-8 holds
    tuned = Tuned(command=command, rate_hz=200.0, rmse_deg=1.0, evaluations=3, values={"k_p": value})
    text = to_toml({"mahony": tuned}, comment)
    assert parse(read_toml(text, "x"), Tuning, "x").root == {"mahony": tuned}


def run(code: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, code] if isinstance(code, Path) else [sys.executable, "-c", code],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
    )


def test_a_mistyped_opengl_is_one_warning():
    done = run("import quadsim.plant; print('flies')", MUJOCO_GL="bogus")
    assert done.stdout == "flies\n"
    assert done.stderr == "MUJOCO_GL=bogus is ignored: egl, glfw, osmesa, glx, wgl, cgl are allowed\n"


def test_a_locale_without_a_sign_prints_another():
    code = "import sys; sys.argv[1:] = ['bench', '--help']; from quadsim.cli import main; main()"
    done = run(code, LC_ALL="C", PYTHONUTF8="0", PYTHONCOERCECLOCALE="0", PYTHONIOENCODING="ascii")
    assert done.returncode == 0, done.stderr
    assert "Fly scenarios ? estimators" in done.stdout


def test_help_imports_nothing_that_takes_long():
    code = (
        "import sys; sys.argv[1:] = ['--help']\n"
        "from quadsim.cli import main\n"
        "try: main()\n"
        "finally: print({'gymnasium', 'numpy', 'pydantic', 'filelock'} & set(sys.modules), file=sys.stderr)"
    )
    assert run(code).stderr == "set()\n"


@pytest.mark.parametrize("first", ["quadsim", "gymnasium"])
def test_the_environment_is_registered_whatever_is_imported_first(first):
    second = {"quadsim": "gymnasium", "gymnasium": "quadsim"}[first]
    done = run(f"import {first}, {second}\nprint('quadsim/Quadrotor-v0' in gymnasium.registry)")
    assert done.stdout == "True\n"


def test_without_a_folder_for_compiled_code_there_is_one_warning(tmp_path):
    (tmp_path / "file").touch()
    code = (
        "import os, subprocess, sys\n"
        "from quadsim.rotation import quat_multiply\n"
        "print(quat_multiply([1, 0, 0, 0], [0, 1, 0, 0]))\n"
        "if len(sys.argv) == 1: subprocess.run([sys.executable, __file__, 'child'])\n"
    )
    (tmp_path / "script.py").write_text(code)
    done = run(tmp_path / "script.py", NUMBA_CACHE_DIR=str(tmp_path / "file"))
    assert done.stdout == 2 * "[0. 1. 0. 0.]\n"
    assert done.stderr.count("no compiled code can be stored in") == len(done.stderr.splitlines()) == 1


@pytest.fixture
def kernel(tmp_path, monkeypatch):
    """A file with a compiled function, which imports another, a constant and something else."""
    monkeypatch.setattr(compiled, "ROOT", tmp_path)
    room = tmp_path / "quadsim" / "room"
    room.mkdir(parents=True)
    (room / "kernel.py").write_text(
        "from quadsim.vehicle import (\n    GRAVITY,\n    Vehicle,\n)\n"
        "from .called import g\nfrom .other import h\n@njit\ndef f(): pass\n"
    )
    (room / "called.py").write_text("@njit\ndef g(): pass\n")
    (room / "other.py").write_text("def h(): pass\n")
    (tmp_path / "quadsim" / "vehicle.py").write_text("GRAVITY = 9.81\n")
    return room / "kernel.py"


@pytest.mark.parametrize(("changed", "matters"), [("called", True), ("../vehicle", True), ("other", False)])
def test_compiled_code_follows_the_functions_and_constants_that_its_file_imports(kernel, changed, matters):
    before = compiled.source_digest(kernel, 1)
    with (kernel.parent / f"{changed}.py").open("a") as file:
        file.write("# changed\n")
    assert (compiled.source_digest(kernel, 2) != before) == matters


def test_the_lock_of_a_function_is_free_after_each_compilation_also_one_that_failed():
    @njit(cache=True)
    def triple(x):
        return 3 * x

    assert (triple(2.0), triple(2)) == (6.0, 6)
    with pytest.raises(TypingError):
        triple(None)
    with FileLock(triple._cache.lock.lock_file, timeout=0):
        pass


@pytest.mark.parametrize("content", [b"", pickle.dumps(numba.__version__) + b"cgone\nGone\n."])
def test_an_index_that_was_cut_short_or_is_of_other_source_is_written_anew(content):
    """One of other source is not unpickled: it may name classes that are gone."""

    def triple(x):
        return 3 * x

    index = Path(njit(cache=True)(triple)._cache._cache_file._index_path)
    index.parent.mkdir(parents=True, exist_ok=True)
    index.write_bytes(content)
    assert njit(cache=True)(triple)(2.0) == 6.0
    assert index.stat().st_size > len(content)


def test_processes_that_start_together_compile_a_function_once(tmp_path):
    script = tmp_path / "shared.py"
    script.write_text(
        "import quadsim\n"
        "from quadsim.runs.compiled import njit\n"
        "@njit(cache=True)\n"
        "def f(x):\n"
        "    return x * x + 1.0\n"
        "assert f(2.0) == 5.0\n"
        "print(sum(f.stats.cache_misses.values()))\n"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, str(script)]
    both = [subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    assert sorted(each.communicate()[0].strip() for each in both) == ["0", "1"]


def test_a_process_that_was_forked_compiles_with_a_lock_of_its_own(tmp_path):
    """A child of fork() that misses the cache must not use the parent's lock."""
    code = (
        "import os\n"
        "from quadsim.runs.compiled import njit\n"
        "@njit(cache=True)\n"
        "def double(x): return 2 * x\n"
        "double._cache.lock.acquire(); double._cache.lock.release()\n"
        "child = os.fork()\n"
        "if child == 0: os._exit(double(21) != 42)\n"
        "raise SystemExit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))\n"
    )
    (tmp_path / "forks.py").write_text(code)
    done = run(tmp_path / "forks.py", NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    assert done.returncode == 0, done.stderr


def test_a_record_adds_up_the_time_of_runs_of_the_same_command(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["/usr/bin/quadsim", "bench", "--out", "a b"])
    with recorded(tmp_path):
        time.sleep(0.1)
    first = load_record(tmp_path)
    assert first.command == "quadsim bench --out 'a b'"
    with pytest.raises(KeyboardInterrupt), recorded(tmp_path):
        raise KeyboardInterrupt
    assert load_record(tmp_path).wall_s > first.wall_s > 0.1
    monkeypatch.setattr(sys, "argv", ["quadsim", "bench"])
    with recorded(tmp_path):
        pass
    assert load_record(tmp_path).command == "quadsim bench"
    assert load_record(tmp_path).wall_s < first.wall_s
    with recorded(tmp_path / "refused"):
        pass
    assert load_record(tmp_path / "refused") is None


def test_a_script_whose_calls_its_workers_repeat_is_told_so_in_a_line(tmp_path):
    call = "dict(run_jobs(abs, {1: (-1,), 2: (-2,)}, workers=2))"
    (tmp_path / "script.py").write_text(f"from quadsim.runs.pool import run_jobs\n{call}\n")
    done = run(tmp_path / "script.py", PYTHONPATH=str(Path(__file__).parents[2]))
    assert done.returncode
    assert "put its calls under if __name__ == '__main__':" in done.stderr
    assert "freeze_support" not in done.stderr
