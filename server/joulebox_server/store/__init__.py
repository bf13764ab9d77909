"""Everything the server keeps: all SQL, and the files of the blobs. Never imports fastapi.

A function of this package takes the open database first and is run by `Store.write` (one writer thread, one
`BEGIN IMMEDIATE` around a group of them) or by `Store.read` (a connection a thread, one snapshot).
"""

from joulebox_server.store.database import Store

__all__ = ["Store"]
