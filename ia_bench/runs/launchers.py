"""Where the cells of a table run: processes of this machine, tasks of Ray, or jobs that submitit hands to Slurm.

A launcher is its own settings (``launcher=ray launcher.cpus=4``). It starts runs and says when they are done; what that means
for the table is decided in :mod:`ia_bench.runs.schedule`, for all launchers alike. Workers read scenes and weights and write
results under the same paths as the table, so whatever a cell has saved is found wherever it is tried again.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import Field

from ia_bench.common.errors import InputError, first_line
from ia_bench.common.exit_codes import OK, status_of
from ia_bench.common.machine import cores, total_memory
from ia_bench.runs.config import RunConfig, resolved
from ia_bench.runs.execute import execute

MEMORY_PER_JOB = 3 << 30  # bytes that one job may need at the default preset: no more jobs are started than fit
AS_MANY_AS_FIT = 1_000_000  # cells at a time: whoever runs them decides
ARRAY = 1000  # jobs handed in at once: Slurm's arrays have no more than 1001 unless it is told otherwise
ANSWER_SECONDS = 10  # who does not answer in this time is not there

AtLeastOne = Annotated[int, Field(ge=1)]
Work = tuple[RunConfig, Path]
"""One run to start: its resolved configuration with its command line, and the file for what it says."""


class WorkerDied(RuntimeError):
    """The process that a run was in is gone, and the run has not ended by itself; the message says how in one line."""


@dataclass(frozen=True, eq=False)
class Job:
    """A run that was started.

    Attributes:
        done: Whether it has ended, in whatever way.
        result: Exit status of one that is done, negative for a signal. Raises WorkerDied.
        cancel: Ask it to end; it saves its state first, if it has begun.
    """

    done: Callable[[], bool]
    result: Callable[[], int]
    cancel: Callable[[], object]


Start = Callable[[Sequence[Work]], Iterable[Job]]


@dataclass(frozen=True)
class Local:
    """Processes of this machine, one a cell, so that one that crashes takes no other with it; what every launcher can.

    Attributes:
        attempts: How often a cell is started whose worker dies; each attempt goes on from the last checkpoint.
    """

    extra: ClassVar[str | None] = None  # the package that it needs beyond those of ia_bench, and the name of the extra
    here: ClassVar[bool] = True  # whether cells run on this machine, and may be checked against it
    poll_seconds: ClassVar[float] = 0.1  # between two looks whether jobs are done

    attempts: AtLeastOne = 3

    def jobs_and_threads(self, jobs: int | None, device: str) -> tuple[int, int]:
        """How many cells are started side by side where ``jobs`` are wanted (None: decide), and on how many threads each.

        One GPU does one cell at a time. Depends on the machine and the settings alone, never on what is left to do: threads are
        part of a run's identity, and a table that is resumed or extended has to find its finished cells again.
        Raises InputError for more jobs than cores.
        """
        most = cores()
        if jobs is not None and jobs > most:
            raise InputError(f"jobs={jobs}: expected at most {most}, the cores that this process may use")
        if jobs is None:
            jobs = 1 if device == "cuda" else max(1, min(most, total_memory() // MEMORY_PER_JOB))
        return jobs, max(1, most // jobs)

    @contextmanager
    def opened(self, folder: Path) -> Iterator[Start]:
        """A context that gives a function to start runs with; ``folder`` is for what the launcher has to write."""

        def start(work: Work) -> Job:
            config, path = work
            with path.open("ab") as log:
                command = [sys.executable, "-m", "ia_bench", *config.command]
                process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT)
            return Job(lambda: process.poll() is not None, process.wait, process.terminate)

        yield lambda works: map(start, works)


@dataclass(frozen=True)
class Cluster(Local):
    """Workers that may be on other machines.

    Attributes:
        cpus: CPUs of a cell, which computes on as many threads.
        gpus: GPUs of a cell; with one, cells run with device=cuda unless told otherwise.
        memory_gb: Memory of a cell in GB.
    """

    here: ClassVar[bool] = False

    cpus: AtLeastOne = 1
    gpus: Annotated[int, Field(ge=0)] = 0
    memory_gb: Annotated[float, Field(gt=0)] = 4.0

    def jobs_and_threads(self, jobs: int | None, device: str) -> tuple[int, int]:
        """As many at a time as the cluster has room for, unless fewer are wanted."""
        return jobs or AS_MANY_AS_FIT, self.cpus


@dataclass(frozen=True)
class Ray(Cluster):
    """Tasks of Ray, each in a worker process of its own.

    Attributes:
        address: A running Ray (``auto``: the one on this machine); null starts one here for as long as the table runs.
    """

    extra: ClassVar[str | None] = "ray"

    address: str | None = None

    @contextmanager
    def opened(self, folder: Path) -> Iterator[Start]:
        """Connect to Ray, or start it. Raises InputError for an address at which there is none."""
        import ray

        own = {} if self.address else {"num_cpus": cores(), "include_dashboard": False}
        handler = signal.getsignal(signal.SIGTERM)
        host, _, port = (self.address or "").rpartition(":")
        try:
            if host and port.isdecimal():
                socket.create_connection((host, int(port)), ANSWER_SECONDS).close()  # Ray itself would try for many minutes
            ray.init(self.address or "local", log_to_driver=False, logging_level="ERROR", **own)
        except (OSError, OverflowError, ValueError) as error:
            raise InputError(f"launcher.address={self.address}: expected a running Ray, found none ({first_line(error)})") from None
        signal.signal(signal.SIGTERM, handler)  # Ray would end the process with a status of its own
        # A worker does one run and ends, as a process of Local does: nothing of one run is left to the next.
        options = {"num_cpus": self.cpus, "num_gpus": self.gpus, "memory": int(self.memory_gb * 1e9)}
        task = ray.remote(max_retries=0, max_calls=1, **options)(run_here)

        def start(work: Work) -> Job:
            reference = task.remote(*_arguments(work))
            future = reference.future()

            def result() -> int:
                try:
                    return int(future.result())
                except Exception as error:  # Ray has one for every way in which a worker ends
                    cause = getattr(error, "cause", None) or error
                    raise WorkerDied(f"{type(cause).__name__}: {first_line(cause)}") from None

            return Job(future.done, result, lambda: ray.cancel(reference))

        with (folder / "ray.log").open("w", buffering=1) as said, redirect_stdout(said):  # where Ray prints why workers end
            try:
                yield lambda works: map(start, works)
            finally:
                ray.shutdown()


@dataclass(frozen=True)
class SubmititSlurm(Cluster):
    """Jobs that submitit hands to Slurm, all that are to be started as one array.

    Attributes:
        minutes: A job's time. One that needs longer is ended with its state saved, which costs its cell an attempt.
        partition: Slurm's partition; null takes the cluster's default.
        account: Who pays; null takes the user's default.
        options: Further parameters of submitit's SlurmExecutor, most of them sbatch's: ``launcher.options.qos=low``.
    """

    extra: ClassVar[str | None] = "submitit"
    poll_seconds: ClassVar[float] = 5.0
    cluster: ClassVar[str] = "slurm"
    delay_seconds: ClassVar[float] = 15.0  # that a file of another machine may take to be seen here

    minutes: AtLeastOne = 240
    partition: str | None = None
    account: str | None = None
    options: dict[str, Any] = field(default_factory=dict)

    @contextmanager
    def opened(self, folder: Path) -> Iterator[Start]:
        """Everything that submitit keeps of its jobs goes into ``folder``. Raises InputError for what the cluster does not take."""
        import submitit

        own = {"partition": self.partition, "account": self.account, "array_parallelism": ARRAY, "mem": f"{self.memory_gb:g}GB"}
        asked = {f"slurm_{name}": value for name, value in {**own, **self.options}.items() if value is not None}
        asked |= {"timeout_min": self.minutes, "cpus_per_task": self.cpus, "gpus_per_node": self.gpus}
        try:
            executor = submitit.AutoExecutor(folder=folder.resolve() / "submitit", cluster=self.cluster)
            executor.update_parameters(name="ia_bench", **asked)
        except (RuntimeError, ValueError) as error:
            raise InputError(f"launcher=submitit_{self.cluster}: {first_line(error)}") from None

        def start(works: Sequence[Work]) -> list[Job]:
            try:
                with executor.batch():  # for Slurm one array
                    jobs = [executor.submit(run_here, *_arguments(work)) for work in works]
            except (submitit.core.utils.FailedJobError, subprocess.CalledProcessError, OSError) as error:
                raise InputError(f"launcher=submitit_{self.cluster}: the jobs were refused ({first_line(error)})") from None
            return [self._job(job) for job in jobs]

        yield start

    def _job(self, job: Any) -> Job:  # noqa: ANN401 (of a package without types)
        ended: list[float] = []

        def done() -> bool:
            if not ended and job.done():
                ended.append(time.monotonic())
            return bool(ended) and (job.paths.result_pickle.exists() or time.monotonic() >= ended[0] + self.delay_seconds)

        def result() -> int:
            with suppress(Exception):  # what submitit raises is the job's whole log
                if job.paths.result_pickle.exists():  # else submitit would wait for it, and nobody else be served
                    return int(job.result())
            raise WorkerDied(f"job {job.job_id}, see {job.paths.stderr}")

        return Job(done, result, lambda: self._cancel(job))

    def _cancel(self, job: Any) -> None:  # noqa: ANN401 (as _job)
        job.cancel(check=False)


@dataclass(frozen=True)
class SubmititLocal(SubmititSlurm):
    """Jobs that submitit runs on this machine, to try what would go to Slurm, whose own settings then mean nothing."""

    poll_seconds: ClassVar[float] = 0.1
    cluster: ClassVar[str] = "local"
    delay_seconds: ClassVar[float] = 0.0

    def jobs_and_threads(self, jobs: int | None, device: str) -> tuple[int, int]:
        """As many at a time as there are cores here, unless fewer are wanted."""
        return jobs or max(1, cores() // self.cpus), self.cpus

    def _cancel(self, job: Any) -> None:  # noqa: ANN401 (as _job)
        with suppress(ProcessLookupError):  # it has just ended; the others are still to be asked
            os.kill(int(job.job_id), signal.SIGTERM)  # to a process that hands signals on; submitit's own way kills after a second


LAUNCHERS: dict[str, type[Local]] = {
    "local": Local, "ray": Ray, "submitit_slurm": SubmititSlurm, "submitit_local": SubmititLocal,
}  # fmt: skip
"""By their names on the command line."""


def run_here(content: Mapping[str, Any], log: str, folder: str, variables: Mapping[str, str]) -> int:
    """What a remote worker does: one run in this process, with what it says in ``log``; returns its exit status.

    ``content`` is the run's resolved configuration, which is checked again for the worker's machine; ``folder`` and ``variables``
    are the table's working directory and its environment as far as ia_bench reads it.
    """
    os.chdir(folder)
    os.environ.update(variables)
    signal.signal(signal.SIGUSR2, lambda *_: signal.raise_signal(signal.SIGTERM))  # from submitit, shortly before the time is up
    with Path(log).open("a", encoding="utf-8") as said, redirect_stdout(said), redirect_stderr(said):
        return status_of(lambda: (execute(resolved(content)), OK)[1], resumes=True)


def _arguments(work: Work) -> tuple[dict[str, Any], str, str, dict[str, str]]:
    """What :func:`run_here` is called with."""
    variables = {name: value for name, value in os.environ.items() if name.startswith("IA_BENCH_")}
    return asdict(work[0]), str(work[1].resolve()), os.getcwd(), variables
