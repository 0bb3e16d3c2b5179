"""Errors that a user can mend: one line on stderr and a non-zero exit; only a bug of ours shows a traceback."""

from __future__ import annotations

import errno
import os
import re
import shlex
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from typing import Any, TextIO, cast

import cv2
from hydra.conf import HydraConf
from hydra.core.utils import JobReturn, JobStatus
from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from experiments.config import AppConfig, default_tree, keys, nearest
from pzcap.command.printing import print_anything
from pzcap.io.text import one_line
from pzcap.types import PzcapError


class AlreadyReported(Exception):
    """A job failed and its line is printed. Carries the failure out of a sweep, whose other jobs go on."""


def explain(error: BaseException, config: type[AppConfig] = AppConfig) -> str | None:
    """One line on what is wrong and what to do; None for what is a bug. ``config``: what the application is told."""
    if isinstance(error, PzcapError):
        return one_line(str(error))
    if isinstance(error, MissingConfigException) and error.options:
        group, _, name = str(error.missing_cfg_file).rpartition("/")
        return f"no '{name}' in conf/{group}; {nearest(name, error.options)}"
    if isinstance(error, OverrideParseException):
        return _explain_syntax(error.override)
    if isinstance(error, HydraException | OmegaConfBaseException):
        return _explain_override(error, config)
    if _is_short_of_memory(error):
        what = f" ({one_line(str(error))})" if str(error) else ""
        return f"memory ran out{what}; close other programs, or give fewer reconstruct.threads or a smaller picture"
    if isinstance(error, OSError):
        where = f" while writing {error.filename}" if error.filename else ""
        if error.errno == errno.ENOSPC:
            return f"the disk is full{where}; free some space or choose another folder with hydra.run.dir=FOLDER"
        if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
            return f"{error.filename or 'a file'}: no permission; choose another folder (hydra.run.dir=FOLDER)"
        return one_line(f"{error.filename}: {error.strerror}" if error.filename else str(error))
    return None


def _is_short_of_memory(error: BaseException) -> bool:
    if isinstance(error, cv2.error):
        return error.code == cv2.Error.StsNoMem
    if isinstance(error, RuntimeError):
        return "can't start new thread" in str(error)
    return isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM)


def _value_or_error(job: JobReturn) -> Any:
    """`JobReturn.return_value` without the line that Hydra prints before it raises what a job raised."""
    if job.status == JobStatus.FAILED:
        raise job._return_value
    return job._return_value


def _keep(job: JobReturn, value: Any) -> None:
    job._return_value = value


def guard(main: Callable[[], object], config: type[AppConfig] = AppConfig) -> int:
    """Run ``main``, a Hydra application that is told a ``config``; the exit status."""
    # Hydra swallows exceptions and prints its own several lines, unless it is told to let them through.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    print_anything()
    setattr(JobReturn, "return_value", property(_value_or_error, _keep))  # noqa: B010
    try:
        with _terminable(), redirect_stdout(cast(TextIO, _Output(sys.stdout))):
            main()
            sys.stdout.flush()
    except AlreadyReported:
        return 1
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except Exception as error:
        line = explain(error, config)
        if line is None:
            raise
        print(f"error: {line}", file=sys.stderr)
        return 1
    return 0


class _Output:
    """Standard output; where it takes no more, that is said of it, and not of the disk that the results are on."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        with self._said():
            return self._stream.write(text)

    def flush(self) -> None:
        with self._said():
            self._stream.flush()

    @contextmanager
    def _said(self) -> Iterator[None]:
        try:
            yield
        except BrokenPipeError:  # of `| head`: rich knows what to do
            raise
        except OSError as error:
            os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())  # or Python complains again as it ends
            raise PzcapError(
                f"the output takes no more ({error.strerror}); what was to be printed is lost, what was made is not"
            ) from error


def flags_first(arguments: Sequence[str]) -> list[str]:
    """A Hydra application's arguments, -m before the overrides: it refuses overrides on both sides of it."""
    flags = ("-m", "--multirun")
    return [*(a for a in arguments if a in flags), *(a for a in arguments if a not in flags)]


@contextmanager
def _terminable() -> Iterator[None]:
    """SIGTERM interrupts as the keyboard does: what is half done is cleared away, and the command says that it ends.
    Where interrupts are ignored, as of what a shell runs in the background, they go on being."""
    if threading.current_thread() is not threading.main_thread():  # no other is given signals
        yield
        return
    before = {each: signal.getsignal(each) for each in (signal.SIGTERM, signal.SIGINT)}
    asked = [each for each, handler in before.items() if handler is not signal.SIG_IGN or each is signal.SIGTERM]
    for each in asked:
        signal.signal(each, signal.default_int_handler)
    try:
        yield
    finally:
        for each in asked:
            signal.signal(each, before[each])


def report(error: Exception) -> bool:
    """Print the line of ``error``, if it is one for the user."""
    line = explain(error)
    if line is not None:
        print(f"error: {line}", file=sys.stderr, flush=True)
    return line is not None


@contextmanager
def reported() -> Iterator[None]:
    """Around the work of a Hydra job: what a user can mend is said there and then, and is carried out of the sweep."""
    try:
        yield
    except Exception as error:
        if report(error):
            raise AlreadyReported(str(error)) from error
        raise


def _explain_override(error: HydraException | OmegaConfBaseException, config: type[AppConfig]) -> str:
    text = str(error)
    unknown = re.search(r"Could not override '([^']+)'", text) or re.search(r"Key '([^']+)' is not in struct", text)
    if unknown is not None:
        key = unknown.group(1)
        if key.startswith("settings."):
            return f"unknown key '{key}'; settings of an estimator are added: +{key}=VALUE"
        hydra = {"hydra": OmegaConf.to_container(OmegaConf.structured(HydraConf))}
        known = keys(hydra) if key.startswith("hydra.") else ["experiment", *keys(default_tree(config))]
        return f"unknown key '{key}'; {nearest(key, known)}"
    return one_line(text)


def _explain_syntax(override: str) -> str:
    key, _, value = override.partition("=")
    if not value:
        return f"cannot read '{override}'; settings are given as key=value"
    quoted = shlex.quote(f'{key}="{value}"')
    return f"cannot read '{override}'; a value with signs such as = or ( goes in quotes: {quoted}"
