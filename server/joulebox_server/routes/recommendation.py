"""Settings for a budget, and the runs that would confirm better ones."""

from typing import Annotated, Any

from fastapi import Query
from sqlite_utils import Database

from joulebox_server import observations
from joulebox_server.analysis.budgets import make_budget
from joulebox_server.analysis.documents import Axis, Recommendation
from joulebox_server.analysis.fleet import transferred
from joulebox_server.analysis.recommend import PROPOSALS, recommend
from joulebox_server.problems import told
from joulebox_server.routes.paging import Key
from joulebox_server.routes.versioned import versioned
from joulebox_server.schemas.answers import Confirmed
from joulebox_server.schemas.base import Document
from joulebox_server.services import Operator, ServicesOf, Viewer
from joulebox_server.store import confirmation

MAX_PROPOSALS = 50

Positive = Annotated[float | None, Query(gt=0, allow_inf_nan=False)]

router = versioned("findings")


class RecommendationQuery(Document):
    """What is asked; a misspelt budget is an error, or the answer would be to a question without one."""

    scene: str | None = None
    device: str | None = None
    budget_j: Positive = None
    budget_s: Positive = None
    budget_wh: Positive = None
    battery_percent: Annotated[float | None, Query(gt=0, le=100, allow_inf_nan=False)] = None
    images: Annotated[int | None, Query(ge=1)] = None
    difference_limit: Positive = None
    confidence: Annotated[float, Query(ge=0.5, le=0.999)] = 0.95
    predict: bool = False


class ConfirmRequest(Document):
    """`POST ...:confirm`."""

    count: Annotated[int, Query(ge=1, le=MAX_PROPOSALS)]


@router.get("/sweeps/{sweep}/recommendation", responses=told(404, 409))
def get_recommendation(
    services: ServicesOf,
    _: Viewer,
    sweep: Key,
    asked: Annotated[RecommendationQuery, Query()],
) -> Recommendation:
    """Settings for a budget an image: `budget_j`, `budget_s`, or a share of `budget_wh` or of a battery."""
    return services.store.read(_recommended, sweep, asked, PROPOSALS)


@router.post("/sweeps/{sweep}/recommendation:confirm", response_model=Confirmed, responses=told(404, 409, 413, 507))
def confirm(
    services: ServicesOf,
    _: Operator,
    sweep: Key,
    asked: Annotated[RecommendationQuery, Query()],
    request: ConfirmRequest,
) -> dict[str, Any]:
    """Queue the settings that promise most; the recommendation changes as their results arrive."""
    found = services.store.read(_recommended, sweep, asked, request.count)
    queued = services.store.write(confirmation.queue, sweep, found.scene, found.device, found.proposals)
    return {"queued_jobs": queued, "proposals": [choice.model_dump(mode="json") for choice in found.proposals]}


def _recommended(db: Database, sweep: str, asked: RecommendationQuery, proposals: int) -> Recommendation:
    found = observations.tradeoff(db, sweep, asked.scene, asked.device, asked.confidence)
    budget = make_budget(
        joules=asked.budget_j,
        seconds=asked.budget_s,
        watt_hours=asked.budget_wh,
        battery_percent=asked.battery_percent,
        images=asked.images,
        battery_full_j=observations.battery_full_j(db, found.device) if asked.battery_percent is not None else None,
    )
    axis: Axis = "time_s" if budget.seconds is not None else found.main_axis
    fleet = observations.others(db, sweep, found.scene, found.device, asked.confidence)
    return recommend(
        found,
        budget.joules,
        budget.seconds,
        asked.difference_limit,
        predict=asked.predict,
        proposals=proposals,
        told_budget=budget.told,
        transferred=transferred(found, fleet, axis),
    )
