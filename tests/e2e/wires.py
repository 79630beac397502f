"""Wires between processes, with bad weather: connections cut, bytes held up, delayed, lost in the middle, sent twice.

A wire is a TCP proxy of this process before one port. All wires share one event loop in a thread of its own.
"""

import asyncio
import contextlib
import random
import socket
import struct
import threading
from dataclasses import dataclass

UP, DOWN = "up", "down"  # towards the server, and back
_PIECE = 1 << 16


@dataclass(frozen=True)
class Weather:
    """What a wire does to what passes."""

    cut: bool = False  # no connection holds, none is let in
    stalled: tuple[str, ...] = ()  # ways on which nothing comes through
    delay_s: float = 0.0  # each piece waits for up to so long
    drop: float = 0.0  # chance of a piece to be its connection's last, and not whole
    doubled_s: float = 0.0  # new connections are made twice, one copy behind the other by up to this; one is answered


CALM = Weather()


class Wires:
    """The loop that they run in."""

    def __init__(self, seed: int) -> None:
        self.dice = random.Random(seed)
        self.loop = asyncio.new_event_loop()
        self.servers: list[asyncio.Server] = []
        self._thread = threading.Thread(target=self.loop.run_forever, name="wires")
        self._thread.start()

    def to(self, port: int) -> "Wire":
        """A wire to a port of this machine."""
        wire = Wire(self, port)
        asyncio.run_coroutine_threadsafe(wire.open(), self.loop).result()
        return wire

    def close(self) -> None:
        """End all of them."""
        asyncio.run_coroutine_threadsafe(self._end(), self.loop).result()
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join()
        self.loop.close()

    async def _end(self) -> None:
        for server in self.servers:
            server.close()
        tasks = asyncio.all_tasks() - {asyncio.current_task()}
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


class Wire:
    """One of them. ``port`` is where it is entered."""

    def __init__(self, wires: Wires, target: int) -> None:
        self.port = 0
        self.weather = CALM
        self._wires = wires
        self._target = target
        self._open: set[asyncio.WriteTransport] = set()
        self._tasks: set[asyncio.Task[None] | None] = set()  # the loop itself would let go of those that wait
        self._changed = asyncio.Event()

    async def open(self) -> None:
        """Let connections in."""
        server = await asyncio.start_server(self._connected, "127.0.0.1", 0)
        self._wires.servers.append(server)
        self.port = server.sockets[0].getsockname()[1]

    def set(self, weather: Weather, *, cut_first: bool = False) -> None:
        """Have other weather from now on; ``cut_first``: all that is connected ends with it."""

        async def change() -> None:
            self.weather = weather
            if cut_first or weather.cut:
                for transport in list(self._open):
                    _reset(transport)
            self._changed.set()
            self._changed = asyncio.Event()

        asyncio.run_coroutine_threadsafe(change(), self._wires.loop).result()

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self.weather.cut:
            _reset(writer.transport)
            return
        ends, task = [writer], asyncio.current_task()
        self._tasks.add(task)
        self._open.add(writer.transport)
        try:
            copies = 2 if self.weather.doubled_s else 1
            there = [await asyncio.open_connection("127.0.0.1", self._target) for _ in range(copies)]
            ends += [end for _, end in there]
            self._open.update(end.transport for end in ends)
            await self._carry(reader, writer, there)
        except* OSError:  # either end has gone, or nobody listens
            for end in ends:
                _reset(end.transport)
        finally:
            self._tasks.discard(task)
            for end in ends:
                end.close()
                self._open.discard(end.transport)

    async def _carry(
        self,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        there: list[tuple[asyncio.StreamReader, asyncio.StreamWriter]],
    ) -> None:
        """Both ways, until the answers have ended; what was asked is sent on to its end before that."""
        lags = [0.0] * len(there)
        if len(there) > 1:
            lags[self._wires.dice.randrange(2)] = self._wires.dice.uniform(0, self.weather.doubled_s)
        lines = [asyncio.Queue[bytes]() for _ in there]
        sends = [self._send(line, end, lag) for line, (_, end), lag in zip(lines, there, lags, strict=True)]
        async with asyncio.TaskGroup() as tasks:  # whatever fails ends all of it
            for send in sends:
                tasks.create_task(send)
            for copy, _ in there[1:]:
                tasks.create_task(_forget(copy))
            asking = tasks.create_task(self._read(reader, lines))
            await self._answer(there[0][0], writer)
            asking.cancel()
            for line in lines:
                line.put_nowait(b"")

    async def _read(self, reader: asyncio.StreamReader, lines: list[asyncio.Queue[bytes]]) -> None:
        while True:
            piece = await reader.read(_PIECE)
            for line in lines:
                line.put_nowait(piece)
            if not piece:
                return

    async def _send(self, line: asyncio.Queue[bytes], end: asyncio.StreamWriter, lag_s: float) -> None:
        while piece := await line.get():
            await asyncio.sleep(lag_s)
            await self._pass(UP, piece, end)
        if end.can_write_eof():
            end.write_eof()

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while piece := await reader.read(_PIECE):
            await self._pass(DOWN, piece, writer)
        with contextlib.suppress(OSError):
            writer.write_eof()

    async def _pass(self, way: str, piece: bytes, end: asyncio.StreamWriter) -> None:
        if self.weather.delay_s:
            await asyncio.sleep(self._wires.dice.uniform(0, self.weather.delay_s))
        while way in self.weather.stalled:
            await self._changed.wait()
        if self._wires.dice.random() < self.weather.drop:
            end.write(piece[: self._wires.dice.randrange(len(piece))])
            await end.drain()
            raise ConnectionResetError("dropped")
        end.write(piece)
        await end.drain()


def _reset(transport: asyncio.BaseTransport) -> None:
    """End a connection so that the other end cannot take it for having been closed in order."""
    linger = struct.pack("ii", 1, 0)
    with contextlib.suppress(OSError):
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
    transport.abort()


async def _forget(reader: asyncio.StreamReader) -> None:
    while await reader.read(_PIECE):
        pass
