"""The application: everything one server needs is made here from its settings; there are no globals."""

import asyncio
import logging
from collections.abc import AsyncIterator, Callable
from concurrent.futures import Executor
from contextlib import asynccontextmanager

from fastapi import FastAPI
from prometheus_client import CollectorRegistry

from joulebox_server import __version__
from joulebox_server.comparing import Comparer, stop
from joulebox_server.documentation import describe, mount_documentation
from joulebox_server.envelope import Envelope
from joulebox_server.limits import BodyLimit
from joulebox_server.metrics import StoreCollector
from joulebox_server.pages import mount_pages
from joulebox_server.problems import add_problem_handlers
from joulebox_server.routes import (
    blobs,
    devices,
    events,
    findings,
    health,
    pictures,
    recommendation,
    results,
    scenes,
    sweeps,
    views,
    wheels,
    work,
)
from joulebox_server.services import Services
from joulebox_server.settings import ServerSettings
from joulebox_server.store import Store
from joulebox_server.store import events as stored_events
from joulebox_server.store.ids import now_us
from joulebox_server.store.leases import reap, set_back
from joulebox_server.waiting import Bell
from joulebox_server.workers import Workers

log = logging.getLogger("joulebox.server")


def create_app(
    settings: ServerSettings, executor: Executor | None = None, clock: Callable[[], int] = now_us
) -> FastAPI:
    """A server over `settings.data_dir`.

    executor  computes differences and draws charts (`concurrent.futures` interface); None makes
              `settings.workers` processes for the ones and one for the others, which end with the app
    clock     microseconds since 1970, by which leases are judged
    """
    registry = CollectorRegistry()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        async with _running(settings, executor, clock, registry) as services:
            app.state.services = services
            yield

    app = FastAPI(
        title="joulebox",
        version=__version__,
        lifespan=lifespan,
        docs_url=None,  # its pages would load scripts from elsewhere; `documentation` serves its own
        redoc_url=None,
    )
    app.add_middleware(BodyLimit, max_bytes=settings.max_body_bytes, silence_s=settings.body_silence_s)
    app.add_middleware(Envelope, registry=registry, secure=settings.secure)
    add_problem_handlers(app)
    # Tried in this order: first those that devices ask for all the time.
    for part in (work, blobs, events, devices, scenes, views, sweeps, results, findings, recommendation, pictures):
        app.routes.extend(part.router.routes)
    for unversioned in (health, wheels):
        app.routes.extend(unversioned.router.routes)
    mount_documentation(app)
    mount_pages(app)
    describe(app)
    return app


@asynccontextmanager
async def _running(
    settings: ServerSettings, executor: Executor | None, clock: Callable[[], int], registry: CollectorRegistry
) -> AsyncIterator[Services]:
    """The services of an app while it runs; afterwards everything is closed and every process ended."""
    store = Store(settings.data_dir)
    bell = Bell()
    bell.open()
    store.on_event(bell.ring_from_thread)
    # Twice as many comparisons as processes, so that none waits for the next; charts in a process of their own, so
    # that none waits for comparisons.
    comparing, drawing = Workers(settings.workers, executor), Workers(1, executor)
    comparer = Comparer(store, bell, comparing, 2 * settings.workers, settings.max_blob_bytes)
    services = Services(settings, store, bell, comparer, drawing, clock, registry)
    collector = StoreCollector(store)
    registry.register(collector)
    work = (comparer.run(), services.feed.run(), _keep_house(services))
    tasks = [asyncio.create_task(each) for each in work]
    try:
        yield services
    finally:
        bell.close()
        for task in tasks:
            await stop(task)
        for workers in (comparing, drawing):
            await asyncio.to_thread(workers.close)
        registry.unregister(collector)
        await asyncio.to_thread(store.close)


async def _keep_house(services: Services) -> None:
    """Take back ended leases, also while no device asks for work or the clock was set back; drop old events."""
    while True:
        try:
            await services.write(set_back, services.lease_rules, services.clock())
            await services.write(reap, services.lease_rules, services.clock())
            await services.write(stored_events.trim)
            await asyncio.to_thread(services.store.checkpoint)
        except Exception:
            log.exception("housekeeping failed; trying again")
        await asyncio.sleep(services.settings.reap_every_s)
