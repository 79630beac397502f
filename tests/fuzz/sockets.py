"""Spoilt WebSocket frames and handshakes to a real server: it drops the client and goes on."""

import base64
import random
import socket
import struct

import httpx

from tests.fuzz.mutate import spoil

OPCODES = (0, 1, 2, 3, 7, 8, 9, 10, 11, 15)


def handshake(path: str, port: int) -> bytes:
    """A good request to upgrade."""
    key = base64.b64encode(b"0123456789abcdef").decode()
    lines = (f"GET {path} HTTP/1.1", f"Host: 127.0.0.1:{port}", "Upgrade: websocket", "Connection: Upgrade")
    return "\r\n".join([*lines, f"Sec-WebSocket-Key: {key}", "Sec-WebSocket-Version: 13", "", ""]).encode()


def frame(dice: random.Random) -> bytes:
    """A frame (RFC 6455, 5.2), mostly a wrong one: reserved bits and codes, lengths that lie, no mask."""
    data = dice.randbytes(dice.choice((0, 1, 5, 125, 126, 200)))
    head = (dice.choice((0x80, 0x80, 0x00, 0xC0, 0xF0)) | dice.choice(OPCODES)).to_bytes(1, "big")
    mask = dice.choice((0x80, 0x80, 0x80, 0))
    length = dice.choice((len(data), len(data), 0, 125, 126, 127))
    extra = {
        126: struct.pack(">H", dice.choice((len(data), 0, 65535))),
        127: struct.pack(">Q", dice.choice((5, 1 << 62))),
    }
    return head + bytes([mask | length]) + extra.get(length, b"") + (b"\0\0\0\0" if mask else b"") + data


def attack(http: httpx.Client, session_id: str, count: int, seed: int, port: int) -> list[str]:
    """``count`` frames and handshakes, a dozen per connection. What went wrong; there must be nothing."""
    wrong: list[str] = []
    path = f"/v1/sessions/{session_id}/stream"
    for number in range(0, count, 12):
        dice = random.Random(seed << 32 | number)
        request = handshake(path, port)
        spoilt = dice.random() < 0.2
        with socket.create_connection(("127.0.0.1", port), timeout=30) as client:
            client.sendall(spoil(dice, request, request) if spoilt else request)
            if not spoilt:
                if not client.recv(4096).startswith(b"HTTP/1.1 101"):
                    wrong.append(f"connection {number}: a good handshake was refused")
                _send_all(client, [frame(dice) for _ in range(12)])
        if number % 600 == 0 and http.get("/healthz").status_code != 200:
            wrong.append(f"connection {number}: the server is not well")
    return wrong


def _send_all(client: socket.socket, frames: list[bytes]) -> None:
    try:
        for data in frames:
            client.sendall(data)
    except OSError:
        return  # it has hung up, as it should
