"""An OPC UA server with the events of a Parquet file as its history, in a process of its own so that it can be killed.

    python -m support.opcua_server '{"port": 4840, "events": "events.parquet", ...}'

It prints "ready". Its history is a storage of our own over arrays: asyncua's own one in SQL fails on text node ids and
on stamps of whole seconds.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import sys
from datetime import UTC, datetime
from typing import Any

import numpy as np
import polars as pl
from asyncua import Server, ua
from asyncua.crypto.permission_rules import SimpleRoleRuleset, User, UserRole
from asyncua.server.history import HistoryStorageInterface

STATUS = {"good": 0, "uncertain": 0x40000000, "bad": 0x80000000}


class Arrays(HistoryStorageInterface):
    """Reads are counted: the server dies at one of them, answers slowly, or never gets on, as it is told."""

    def __init__(self, said: dict[str, Any]) -> None:
        super().__init__()
        self.said, self.reads = said, 0
        frame = pl.read_parquet(said["events"])
        if "quality" not in frame.columns:
            frame = frame.with_columns(pl.lit("good").alias("quality"))
        self.tags = {str(key[0]): own.sort("time") for key, own in frame.group_by("tag")}
        self.stamps = {tag: own["time"].dt.epoch("us").to_numpy() for tag, own in self.tags.items()}

    async def init(self) -> None:
        """Nothing to open."""

    async def stop(self) -> None:
        """Nor to close."""

    async def read_node_history(self, node_id, start, end, nb_values):
        self.reads += 1
        if self.reads == self.said.get("dies_at"):
            os._exit(1)
        await asyncio.sleep(self.said.get("delay", 0.0))
        tag = str(node_id.Identifier)
        stamps, own = self.stamps[tag], self.tags[tag]
        first = int(np.searchsorted(stamps, _micro(start)))
        last = int(np.searchsorted(stamps, _micro(end), side="right"))
        most = min(nb_values or 10_000, self.said.get("most", 10_000))
        rows = own[first : min(first + most, last)]
        values = [
            ua.DataValue(
                ua.Variant(value, ua.VariantType.Double) if value is not None else ua.Variant(None),
                StatusCode=ua.StatusCode(STATUS[quality]),
                SourceTimestamp=stamp,
            )
            for stamp, value, quality in rows.select("time", "value", "quality").iter_rows()
        ]
        if self.said.get("stuck") and first < last:
            return values, start
        more = first + most < last
        return values, datetime.fromtimestamp(stamps[first + most] / 1e6, UTC) if more else None


def _micro(moment: datetime) -> int:
    at = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    return round(at.timestamp() * 1e6)


class OneUser:
    """Knows one name and password."""

    def __init__(self, name: str, password: str) -> None:
        self.pair = (name, password)

    def get_user(self, iserver, username=None, password=None, certificate=None):
        return User(role=UserRole.User) if (username, password) == self.pair else None


async def serve(said: dict[str, Any]) -> None:
    users = OneUser(*said["user"]) if "user" in said else None
    server = Server(user_manager=users)
    await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{said['port']}/")
    if "certificate" in said:
        policies = [getattr(ua.SecurityPolicyType, name) for name in said["policies"]]
        server.set_security_policy(policies, permission_ruleset=SimpleRoleRuleset())
        await server.set_application_uri("urn:test:server")
        await server.load_certificate(said["certificate"])
        await server.load_private_key(said["private_key"])
        if users is not None:
            server.set_identity_tokens([ua.UserNameIdentityToken])
    else:
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    storage = Arrays(said)
    server.iserver.history_manager.set_storage(storage)
    await server.register_namespace("urn:test:one")
    for tag in storage.tags:
        node = await server.nodes.objects.add_variable(ua.NodeId(tag, 2), tag, 0.0)
        await node.set_attr_bit(ua.AttributeIds.AccessLevel, ua.AccessLevel.HistoryRead)
        unit = ua.EUInformation(DisplayName=ua.LocalizedText("degC"))
        await node.add_property(0, "EngineeringUnits", unit)
        await node.add_property(0, "EURange", ua.Range(Low=0.0, High=400.0))
    async with server:
        print("ready", flush=True)
        await asyncio.Event().wait()


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    asyncio.run(serve(json.loads(sys.argv[1])))
