"""Spread calls over processes of this machine or over a Dask cluster. A lost worker costs only its own call."""

from __future__ import annotations

import logging
import multiprocessing
import os
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar, cast

from ..errors import AdaptiveFaceError, MissingExtraError

#: How many times the shared values are sent again to a cluster that has lost every worker that held them.
SCATTERED = 3
Item = TypeVar("Item")


class WorkerLost(AdaptiveFaceError):
    """The process that worked on an item was killed or crashed, and gave no answer."""


def completed(
    function: Callable[..., Any], items: Sequence[Item], client=None, processes: int = 1, shared: Sequence = ()
) -> Iterator[tuple[Item, Any]]:
    """Yield ``(item, function(*shared, item))`` in the order in which the calls end.

    Parameters
    ----------
    function : callable
        A function of a module, so that other processes can import it.
    items : sequence
        One call is made for each of them.
    client : dask.distributed.Client, optional
        The cluster that makes the calls. It replaces lost workers itself.
    processes : int
        Without a client: the number of processes that work at the same time. Each item gets a new process. With 0, the
        calls are made in this process.
    shared : sequence
        Leading arguments of every call. They are sent to each worker of a cluster only once.

    Yields
    ------
    item, answer
        ``answer`` is the result of the call, or the exception that it raised. It is a :class:`WorkerLost` if the process
        ended without an answer.
    """
    if client is not None:
        yield from _on_cluster(function, items, client, shared)
    elif processes:
        yield from _in_processes(function, items, processes, shared)
    else:
        for item in items:
            yield item, _attempt(function, *shared, item)


def _attempt(function, *arguments):
    try:
        return function(*arguments)
    except Exception as error:  # noqa: BLE001 - the caller decides what an error means
        return error


def _on_cluster(function, items, client, shared) -> Iterator[tuple[Any, Any]]:
    from distributed import as_completed

    left = list(items)
    for _ in range(SCATTERED):
        common = [client.scatter(value, broadcast=True) for value in shared]
        futures = {client.submit(function, *common, item, pure=False): item for item in left}
        left = []
        try:
            for future in as_completed(futures):
                item = futures[future]
                error = None if future.cancelled() else future.exception()
                if future.cancelled():  # the shared values were lost with the last worker that held them
                    left.append(item)
                elif error is None:
                    yield item, future.result()
                elif type(error).__name__ == "KilledWorker":
                    yield item, WorkerLost("each worker of the cluster that took it was lost")
                else:
                    yield item, error
        finally:
            client.cancel([future for future in futures if not future.done()])
        if not left:
            return
    for item in left:
        yield item, WorkerLost("all workers of the cluster were lost, again and again")


def _in_processes(function, items: Iterable, processes: int, shared) -> Iterator[tuple[Any, Any]]:
    context = multiprocessing.get_context("spawn")  # a fork would copy threads that hold locks
    waiting = list(items)[::-1]
    running: dict[Any, tuple[Any, Any]] = {}
    try:
        while waiting or running:
            while waiting and len(running) < processes:
                item = waiting.pop()
                answer, theirs = context.Pipe(duplex=False)
                worker = context.Process(target=_worker, args=(function, (*shared, item), theirs))
                worker.start()
                theirs.close()
                running[answer] = (item, worker)
            for ready in wait(list(running)):
                answer = cast(Connection, ready)
                item, worker = running.pop(answer)
                yield item, _received(answer, worker)
    finally:
        for _, worker in running.values():
            worker.terminate()
        for _, worker in running.values():
            worker.join()


def _received(answer: Connection, worker) -> Any:
    with answer:
        try:
            return answer.recv()
        except EOFError:
            pass
    worker.join()
    code = worker.exitcode
    how = f"by signal {-code}" if code and code < 0 else f"with status {code}"
    return WorkerLost(f"its process was ended {how} (out of memory, or killed)")


def _worker(function, arguments, answer: Connection) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    answer.send(_attempt(function, *arguments))
    answer.close()


def _end_with_parent() -> None:
    """End this process once its parent is gone, so that a killed batch leaves no workers behind."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


def dask_client(address: str | None = None, workers: int = 2):
    """Connect to a Dask cluster, or start one. It ends with ``client.close()``.

    Parameters
    ----------
    address : str, optional
        Address of a running scheduler, such as ``tcp://host:8786``. With None, a cluster of ``workers`` processes is
        started on this machine. It listens on loopback only.

    Returns
    -------
    dask.distributed.Client
        The connection.

    Raises
    ------
    MissingExtraError
        Dask is not installed.
    AdaptiveFaceError
        No scheduler answers at ``address``.
    """
    try:
        from distributed import Client
    except ImportError:
        raise MissingExtraError('Dask is not installed: python -m pip install "adaptiveface[cluster]"') from None
    if address is not None:
        try:
            return Client(address, timeout=10)
        except (OSError, ValueError) as error:
            raise AdaptiveFaceError(f"no Dask scheduler answers at {address}: {error}") from None
    # Workers that end too slowly are killed. A warning about that would be printed below the results.
    return Client(n_workers=workers, threads_per_worker=1, dashboard_address=None, silence_logs=logging.ERROR)
