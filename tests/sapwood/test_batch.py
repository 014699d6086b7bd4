"""The pool of workers: deaths, interruptions, order."""

import os
import signal
import time

import pytest
from sapwood_scans import spawn

from sapwood.batch import DIED, DONE, INPUT, INTERNAL, Job, Outcome, run_batch, run_job


def job(name, **options):
    return Job(f"{name}.xyz", name, "out", "out", options)


def act(work):
    """Runs in the worker: what the job's name says."""
    if work.name == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if work.name == "leave":
        os._exit(7)
    if work.name == "sleep":
        time.sleep(600)
    if work.name == "print":
        os.write(1, b"noise from a library\n")
    return Outcome(work, DONE, report={"pid": os.getpid()})


@pytest.mark.parametrize("n_workers", [1, 2])
def test_a_worker_that_dies_fails_its_own_scan_only(n_workers):
    jobs = [job("a"), job("kill"), job("b"), job("leave"), job("c")]
    found = {outcome.job.name: outcome for outcome in run_batch(jobs, n_workers, act)}
    assert {name: outcome.kind for name, outcome in found.items()} == {
        "a": DONE, "kill": DIED, "b": DONE, "leave": DIED, "c": DONE,
    }  # fmt: skip
    assert found["kill"].message == (
        "kill.xyz: its process ended on signal 9 (killed from outside, most often for lack of memory; "
        "try fewer --jobs)."
    )
    assert found["leave"].message == "leave.xyz: its process ended unexpectedly (status 7)."


def test_a_worker_does_one_job_after_the_other():
    found = list(run_batch([job(name) for name in "abc"], 1, act))
    assert [outcome.job.name for outcome in found] == ["a", "b", "c"]
    assert len({outcome.report["pid"] for outcome in found}) == 1


def test_leaving_early_ends_the_workers():
    start = time.monotonic()
    for outcome in run_batch([job("a"), job("sleep"), job("sleep")], 2, act):
        assert outcome.job.name == "a"
        break
    assert time.monotonic() - start < 30


def test_what_a_library_prints_does_not_mix_with_results(capfd):
    assert [outcome.kind for outcome in run_batch([job("print")], 1, act)] == [DONE]
    said = capfd.readouterr()
    assert said.out == ""
    assert said.err == "noise from a library\n"


def test_no_jobs():
    assert list(run_batch([], 4, act)) == []


def test_a_full_disk_is_not_our_fault(monkeypatch, tmp_path, scans):
    import sapwood.saving

    def full(*_, **__):
        raise OSError(28, "No space left on device", "out/.part")

    monkeypatch.setattr(sapwood.saving, "save", full)
    outcome = run_job(Job(str(scans / "bare.xyz"), "bare", str(tmp_path), str(tmp_path)))
    assert (outcome.kind, outcome.message) == (INPUT, "out/.part: No space left on device.")


def test_memory_that_runs_out_is_one_line(monkeypatch, tmp_path, scans):
    import sapwood.saving

    def greedy(*_, **__):
        raise MemoryError

    monkeypatch.setattr(sapwood.saving, "save", greedy)
    outcome = run_job(Job(str(scans / "bare.xyz"), "bare", str(tmp_path), str(tmp_path)))
    advice = "memory ran out; thin the scan with --max-points, or use fewer --jobs."
    assert (outcome.kind, outcome.message) == (INPUT, f"{scans / 'bare.xyz'}: {advice}")


@pytest.mark.parametrize(
    "kinds, code",
    [
        ([], 0),
        ([DONE, DONE], 0),
        ([DONE, INPUT], 3),
        ([DONE, INTERNAL], 3),
        ([INPUT, INPUT], 2),
        ([INPUT, INTERNAL], 1),
        ([INPUT, DIED], 1),
        ([DIED], 1),
    ],
)
def test_exit_codes(kinds, code):
    from sapwood.cli.reconstruct import _exit_code

    outcomes = [Outcome(job(str(k)), kind) for k, kind in enumerate(kinds)]
    assert _exit_code(outcomes, [outcome for outcome in outcomes if outcome.kind != DONE]) == code


def test_results_come_in_the_order_of_the_scans(monkeypatch, run, scans):
    import sapwood.batch

    def backwards(jobs, n_workers):
        yield from (run_job(work) for work in reversed(jobs))

    monkeypatch.setattr(sapwood.batch, "run_batch", backwards)
    arguments = [scans / "bare.xyz", "missing.laz", scans / "leafy.xyz", "gone.laz"]
    done = run("reconstruct", *arguments, "-o", "out", "--no-preview")
    assert [line.split(":")[0] for line in done.out.splitlines()] == ["bare", "leafy"]
    assert [line.split(":")[1] for line in done.err.splitlines()[-2:]] == [" missing.laz", " gone.laz"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_leaves_nothing_half_written(scans, tmp_path, number):
    process = spawn(
        "reconstruct", scans, "-o", "out", "--no-preview", "--jobs", "2", cwd=tmp_path, start_new_session=True
    )
    wait_for(lambda: list(tmp_path.glob("out/.sapwood-*")))
    time.sleep(0.3)
    if number == signal.SIGINT:
        os.killpg(process.pid, number)  # as Ctrl-C does: everything that hangs on the terminal
    else:
        process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert err.splitlines()[-1] == "error: interrupted; what was not finished has been removed."
    assert "Traceback" not in err
    left = list((tmp_path / "out").iterdir()) if (tmp_path / "out").exists() else []
    assert not [path for path in left if path.name.startswith(".")]


def wait_for(condition, seconds=30.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.02)
