"""An application that asks for keys, and clients of several tenants and roles."""

from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

import httpx
from api_client import Api, running, served
from fastapi import FastAPI

from service.access.principal import Role

BOOTSTRAP = "b" * 40


class Callers:
    """Makes keys past the API, as the command line does, and clients that send them."""

    def __init__(self, app: FastAPI, stack: AsyncExitStack, address: str = "") -> None:
        self.app = app
        self.address = address  # host:port, where it is served
        self._stack = stack

    async def key(self, tenant: str, role: str = "admin", name: str = "test") -> str:
        record, text = await self.app.state.services.keys.create(tenant, Role(role), name, None)
        assert record.id in text
        return text

    async def client(self, tenant: str, role: str = "admin", name: str = "test") -> Api:
        return await self.with_token(await self.key(tenant, role, name))

    async def with_token(self, token: str | None) -> Api:
        headers = {} if token is None else {"Authorization": f"Bearer {token}"}
        transport = httpx.ASGITransport(self.app, raise_app_exceptions=False)
        client = httpx.AsyncClient(transport=transport, base_url="http://pose.example", headers=headers, timeout=60)
        return Api(await self._stack.enter_async_context(client), self.app)


def with_keys(make_app: Callable[..., FastAPI], folder: Path, **settings: object) -> FastAPI:
    """The application with keys required, and a bootstrap key."""
    file = folder / "bootstrap"
    file.write_text(BOOTSTRAP + "\n")
    return make_app(**{"auth": "required", "bootstrap_key_file": file, **settings})


@asynccontextmanager
async def guarded(make_app: Callable[..., FastAPI], folder: Path, **settings: object) -> AsyncIterator[Callers]:
    """That application within its lifespan, without a server."""
    app = with_keys(make_app, folder, **settings)
    async with AsyncExitStack() as stack, running(app):
        yield Callers(app, stack)


@asynccontextmanager
async def guarded_server(make_app: Callable[..., FastAPI], folder: Path, **settings: object) -> AsyncIterator[Callers]:
    """That application on a real port; the clients reach it beside."""
    app = with_keys(make_app, folder, **settings)
    async with AsyncExitStack() as stack, served(app) as address:
        yield Callers(app, stack, address)
