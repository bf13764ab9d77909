"""The fleet server as the agent sees it: JSON over HTTP, blobs by hash, errors turned into three kinds.

ServerUnreachableError: try again later. TokenRejectedError: stop. ServerRefusedError: never repeat this.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import httpx2
import stamina
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from joulebox_agent.errors import ServerRefusedError, ServerUnreachableError, TokenRejectedError, UsageError

LARGEST_BUNDLE_BYTES = 512 * 2**20
QUICK_TRIES = 3  # within one call; the daemon's own pauses come after
Id = Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]{1,100}$")]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


Model = TypeVar("Model", bound=BaseModel)


class _Answer(BaseModel):
    # a newer server may say more than this agent knows
    model_config = ConfigDict(frozen=True, extra="ignore")


class LeasedScene(_Answer):
    name: str
    bundle_sha256: Sha256


class LeasedRule(_Answer):
    window_s: float = 60.0
    min_windows: int = 5
    max_windows: int = 20
    half_width: float = 0.05
    max_seconds: float = 900.0
    meter: bool = True


class Lease(_Answer):
    """One job, ours until it expires; the attempt id is the key under which its result is sent."""

    attempt_id: Id
    job_id: str
    sweep_id: str
    purpose: Literal["measure", "reference", "noise_floor"]
    scene: LeasedScene
    defines: dict[str, str] = {}
    settings: dict[str, Any]
    measure: LeasedRule


class _Leases(_Answer):
    leases: list[Lease]


class _Accepted(_Answer):
    accepted: str


class _Device(_Answer):
    device_id: str
    token: str


class Server:
    """One server. `transport` is for tests; `quick_wait_s` is the first pause between quick tries."""

    def __init__(
        self,
        url: str,
        token: str | None = None,
        transport: httpx2.BaseTransport | None = None,
        timeout_s: float = 30.0,
        quick_wait_s: float = 0.2,
    ) -> None:
        if not url.startswith(("http://", "https://")):
            raise UsageError(f"The server {url!r} must be a URL such as http://127.0.0.1:8080.")
        self.url = url.rstrip("/")
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        try:
            self._client = httpx2.Client(
                base_url=self.url + "/v1", headers=headers, transport=transport, timeout=timeout_s
            )
        except (httpx2.InvalidURL, ValueError) as error:
            raise UsageError(f"The server {url!r} is not a URL: {error}.") from error
        self._quick_wait_s = quick_wait_s

    def close(self) -> None:
        self._client.close()

    def enroll(self, code: str, name: str, boot_id: str) -> tuple[str, str]:
        """(device id, token) for a one-time code or the shared enrolment secret."""
        answer = self._call("POST", "/devices", json={"code": code, "name": name, "boot_id": boot_id})
        device = _read(_Device, answer)
        return device.device_id, device.token

    def put_capabilities(self, device_id: str, capabilities: dict[str, Any]) -> None:
        self._call("PUT", f"/devices/{device_id}/capabilities", json=capabilities)

    def lease(
        self, boot_id: str, conditions: dict[str, Any], wait_s: float, holding: Sequence[str] = ()
    ) -> tuple[list[Lease], float]:
        """(jobs, seconds to wait before asking again). Asked once: a lease must not be taken twice.

        holding  attempts that are worked on; the server takes back what else it leased to this device, whose
                 answer was lost on the way or with an earlier process
        """
        body = {
            "boot_id": boot_id, "conditions": conditions, "max_jobs": 1, "wait_s": wait_s, "holding": list(holding),
        }  # fmt: skip
        answer = self._once("POST", "/leases", json=body, timeout=wait_s + 30)
        if answer.status_code == 204:
            return [], _retry_after_s(answer)
        return _read(_Leases, answer).leases, 0.0

    def release(self, attempt_id: str, reason: str, failed: bool) -> None:
        self._call("POST", f"/attempts/{attempt_id}/release", json={"reason": reason[:2000], "failed": failed})

    def put_blob(self, sha256: str, content: bytes, even_if_there: bool = False) -> None:
        """Stores bytes under their hash, unless the server has them."""
        if not even_if_there:
            try:
                self._call("HEAD", f"/blobs/{sha256}")
                return
            except ServerRefusedError as error:
                if error.status != 404:
                    raise
        headers = {"Content-Type": "application/octet-stream"}
        self._call("PUT", f"/blobs/{sha256}", content=content, headers=headers)

    def put_result(self, attempt_id: str, document: dict[str, Any]) -> str:
        """ "ok" or "late"; "again" when the server had this very document.

        Only the server's own words count: whoever else answers (the sign-in page of a network) has not stored it.
        """
        answer = self._call("PUT", f"/attempts/{attempt_id}/result", json=document)
        accepted = _read(_Accepted, answer).accepted
        return "again" if answer.status_code == 200 else accepted

    def download(self, sha256: str, target: Path) -> None:
        """Writes a blob to `target`. Raises ServerRefusedError when it is larger than a bundle may be."""
        for attempt in self._quick_tries():
            with attempt:
                self._download_once(sha256, target)

    def _download_once(self, sha256: str, target: Path) -> None:
        try:
            with self._client.stream("GET", f"/blobs/{sha256}") as answer, target.open("wb") as file:
                if answer.status_code >= 400:
                    answer.read()
                self._check(answer)
                size = 0
                for chunk in answer.iter_bytes():
                    size += len(chunk)
                    if size > LARGEST_BUNDLE_BYTES:
                        raise ServerRefusedError(f"The blob {sha256[:12]} is larger than 512 MiB.", 413)
                    file.write(chunk)
        except httpx2.TransportError as error:
            raise self._unreachable(error) from error

    def _quick_tries(self) -> Iterator[stamina.Attempt]:
        return iter(
            stamina.retry_context(
                on=ServerUnreachableError,
                attempts=QUICK_TRIES,
                timeout=None,
                wait_initial=self._quick_wait_s,
                wait_max=10 * self._quick_wait_s,
                wait_jitter=self._quick_wait_s,
            )
        )

    def _call(self, method: str, path: str, **request: Any) -> httpx2.Response:
        answer: httpx2.Response | None = None
        for attempt in self._quick_tries():
            with attempt:
                answer = self._once(method, path, **request)
        assert answer is not None
        return answer

    def _once(self, method: str, path: str, **request: Any) -> httpx2.Response:
        try:
            answer = self._client.request(method, path, **request)
        except httpx2.TransportError as error:
            raise self._unreachable(error) from error
        self._check(answer)
        return answer

    def _unreachable(self, error: Exception) -> ServerUnreachableError:
        return ServerUnreachableError(f"The server at {self.url} cannot be reached: {error or type(error).__name__}.")

    def _check(self, answer: httpx2.Response) -> None:
        status = answer.status_code
        if status < 300:
            return
        detail, code = _problem(answer)
        if status != 413 and not _speaks_problems(answer):
            raise ServerUnreachableError(
                f"Something else than a joulebox server answers at {self.url}: {status} {detail}"
            )
        if status == 401:
            raise TokenRejectedError(
                f"The server at {self.url} rejects this device's credentials ({detail}); "
                "check the code or enrol again with --again."
            )
        # Bytes that were hurt on the way are sent again: the spool has checked them against their name.
        if status == 429 or status >= 500 or code == "wrong_digest":
            raise ServerUnreachableError(f"The server at {self.url} asks to wait: {status} {detail}")
        raise ServerRefusedError(f"The server at {self.url} refused: {status} {detail}", status, code)


def _read(model: type[Model], answer: httpx2.Response) -> Model:
    """The answer as `model`. Raises ServerUnreachableError: anything else is not a joulebox server."""
    try:
        return model.model_validate_json(answer.content)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "body"
        raise ServerUnreachableError(
            f"The answer of {answer.request.url} is not understood: {where}: {first['msg']}."
        ) from error


def _speaks_problems(answer: httpx2.Response) -> bool:
    """Whether a refusal has the form in which every joulebox server refuses (RFC 9457)."""
    return str(answer.headers.get("Content-Type", "")).startswith("application/problem+json")


def _problem(answer: httpx2.Response) -> tuple[str, str]:
    """(sentence, code) of an RFC 9457 problem document, or of whatever came instead."""
    try:
        problem = answer.json()
        sentence = str(problem.get("detail") or problem.get("title") or answer.reason_phrase)
        fields = [str(e.get("detail") or e.get("msg") or e) for e in problem.get("errors") or [] if isinstance(e, dict)]
        return "; ".join([sentence, *fields]), str(problem.get("code") or "")
    except (ValueError, AttributeError):
        return answer.reason_phrase or "no reason given", ""


def _retry_after_s(answer: httpx2.Response) -> float:
    try:
        return max(0.0, float(answer.headers.get("Retry-After", "1")))
    except ValueError:
        return 1.0
