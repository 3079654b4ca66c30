"""Function calls on a Dask cluster whose workers have the same files under the same paths.

`distributed` is an optional extra, imported only when a scheduler is given.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from bubbleviz.errors import InputError
from bubbleviz.plugins import library
from bubbleviz.wording import reason_of

Item = TypeVar("Item")
Answer = TypeVar("Answer")
TIMEOUT_S = 5.0  # for connections to the scheduler; chosen


def run_on_cluster(
    function: Callable[[Item], Answer], items: Sequence[Item], address: str
) -> Generator[tuple[Item, Answer | None, str]]:
    """Items with return value or error message, in the order in which the calls finish.

    Closing the iterator cancels pending calls.

    Raises InputError: the optional library is missing, no scheduler answers, or the connection is
    lost.
    """
    with _client(address) as client:
        from distributed import CancelledError, as_completed

        futures = client.map(function, items, pure=False)
        by_key = {future.key: item for future, item in zip(futures, items, strict=True)}
        try:
            for future in as_completed(futures, loop=client.loop):
                if client.status != "running" or future.status == "cancelled":
                    raise _lost(address)
                item, error = by_key[future.key], future.exception()
                if error is None:
                    yield item, future.result(), ""
                else:
                    yield item, None, f"{type(error).__name__}: {reason_of(error, 300)}"
        except (CancelledError, OSError) as error:
            raise _lost(address) from error
        finally:
            if client.status == "running":
                client.cancel(futures)


def check_cluster(address: str) -> None:
    """Raise InputError unless a scheduler with workers answers."""
    with _client(address):
        pass


@contextmanager
def _client(address: str) -> Iterator[Any]:
    dask = library("distributed", "cluster", f"--scheduler {address}", "leave --scheduler out")
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # replaced by InputError
    try:
        # A Client without scheduler prints a traceback and blocks when it is deleted: check first.
        if asyncio.run(_kind_of_server(address)) != "Scheduler":
            raise ValueError("not a Dask scheduler")
        client = dask.Client(address, timeout=TIMEOUT_S, set_as_default=False)
    except Exception as error:  # with other servers Dask raises arbitrary exceptions
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers; start one "
            "with `dask scheduler`, or check address and port"
        ) from error
    try:
        try:
            client.wait_for_workers(1, timeout=TIMEOUT_S)
        except TimeoutError as error:
            raise InputError(
                f"--scheduler {address}: the scheduler has no workers; start `dask worker "
                f"{address}` where the recordings are"
            ) from error
        yield client
    finally:
        client.close(timeout=TIMEOUT_S)


async def _kind_of_server(address: str) -> str:
    from distributed import rpc

    async with rpc(address, timeout=TIMEOUT_S) as server:
        identity = await asyncio.wait_for(server.identity(), TIMEOUT_S)
    return str(identity.get("type"))


def _lost(address: str) -> InputError:
    return InputError(
        f"--scheduler {address}: the connection to the scheduler is lost; check or restart the "
        "scheduler, and continue with --resume"
    )
