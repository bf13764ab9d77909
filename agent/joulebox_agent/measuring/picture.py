"""The last picture of a configuration, on disk whatever stopped its renderer."""

from joulebox_agent.errors import RendererError
from joulebox_agent.loop import DoneEvent, ImageEvent
from joulebox_agent.measuring.meter import LOOK_EVERY_S, Meter
from joulebox_agent.measuring.recording import Recording
from joulebox_agent.measuring.visit import Job, LoopFactory


def keep_picture(record: Recording, job: Job, meter: Meter, make_loop: LoopFactory, silence_s: float) -> None:
    """Renders once more where the renderer was stopped before it wrote its picture. Without room for it the
    measurement still stands, with a note; other pixels than before void it.

    silence_s  longest silence of the renderer [s]
    """
    if record.void is not None or record.last_image is None or job.image_file.exists():
        return
    try:
        _render_once(record, record.last_image.pixel_sha256, job, meter, make_loop, silence_s)
    except RendererError as error:
        record.note(f"the picture was not kept: {error}")
    if not job.image_file.exists():
        record.note("the renderer wrote no picture")


def _render_once(
    record: Recording, pixel_sha256: str, job: Job, meter: Meter, make_loop: LoopFactory, silence_s: float
) -> None:
    arguments = [*job.arguments, "-o", str(job.image_file), "--max-images", "1"]
    clock = meter.clock
    with make_loop(job.command, arguments, clock, lambda line: None) as loop:
        heard_s = clock.now_s()
        while not isinstance(event := loop.next_event(LOOK_EVERY_S), DoneEvent):
            meter.check_stop()
            heard_s = heard_s if event is None else clock.now_s()
            if clock.now_s() - heard_s > silence_s:
                raise RendererError(f"The renderer said nothing for {silence_s:g} s; it was ended.")
            if isinstance(event, ImageEvent) and event.pixel_sha256 != pixel_sha256:
                record.make_void("the picture changed when it was rendered once more to keep it", False)
