"""Which web pages may talk to the viewer: its own alone."""

from __future__ import annotations

import ipaddress
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

if TYPE_CHECKING:
    import viser
    from viser.infra import WebsockClientConnection

_POLICY_VIOLATION = 1008


def refuse_other_pages(server: viser.ViserServer, host: str) -> None:
    """Close connections that pages of other origins open, before anything is sent to them.

    A browser lets every page that it shows connect to ports of its own machine. viser takes them all.

    Args:
        server: that listens.
        host: the address that it listens on.
    """
    websockets = server._websock_server

    async def check(client: WebsockClientConnection) -> None:
        connection = websockets._live_connections[client.client_id]
        headers = connection.request.headers if connection.request is not None else {}
        if not is_own_page(headers.get("Origin"), headers.get("Host"), host):
            await connection.close(_POLICY_VIOLATION, "a page of another origin")

    websockets.on_client_connect(check)
    websockets.disconnect_all_clients()  # who came before; a page of its own comes again by itself


def is_own_page(origin: str | None, address: str | None, host: str) -> bool:
    """Whether a page may talk to a server.

    Args:
        origin: where the page is from, by the header Origin; no browser leaves it out.
        address: of the server, by the header Host.
        host: that the server listens on. Where that is this machine alone, the page must be from a name of
            this machine: any other name could have been made to lead here.
    """
    if origin is None:
        return True
    try:
        page = urlsplit(origin)
    except ValueError:
        return False
    same = page.netloc.lower() == (address or "").lower() != ""
    return same and (not _is_this_machine(host) or _is_this_machine(page.hostname or ""))


def _is_this_machine(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
