"""A scripted program that speaks the loop protocol, for tests of the agent. It renders nothing.

What it does is set through `--set`, as a renderer's settings are:
    image_s=0.02   length of an image, in the stages direct and indirect
    direct=0.25    share of the first of them
    gap_s=0        pause between images
    misbehave=...  die, garbage, number, hang, hang_at_once, flicker, backwards, other_clock, ignore_term, stop
    misbehave_at=3 image at which it does so
`jobs` does one loop after the other, as the renderer's does; not with FAKE_ALONE=1 in the environment.
`seed=...` goes into the pixel hash; any setting but these is refused with exit code 2, as a renderer would.
"""

import hashlib
import json
import os
import signal
import sys
import time

KNOWN = {"image_s": 0.02, "direct": 0.25, "gap_s": 0.0, "misbehave": "", "misbehave_at": 3, "seed": 0, "preset": "",
         "write": "end"}  # fmt: skip
SCHEMA = {"type": "object", "properties": {key: {} for key in KNOWN}, "additionalProperties": False}


def now_s():
    return time.perf_counter_ns() / 1e9


def tell(**event):
    print(json.dumps(event), flush=True)


def refuse(sentence):
    print(sentence, file=sys.stderr, flush=True)
    sys.exit(2)


def parse(words):
    options = {"settings": dict(KNOWN), "output": None, "max_images": None, "max_seconds": None, "defines": {},
               "scene": None}  # fmt: skip
    words = list(words)
    while words:
        word = words.pop(0)
        if word in ("--set", "-D"):
            key, _, text = words.pop(0).partition("=")
            if word == "-D":
                options["defines"][key] = text
                continue
            set_one(options["settings"], key, text)
        elif word == "--settings":
            with open(words.pop(0)) as file:
                for key, value in json.load(file).items():
                    set_one(options["settings"], key, value)
        elif word == "-o":
            options["output"] = words.pop(0)
        elif word == "--max-images":
            options["max_images"] = int(words.pop(0))
        elif word == "--max-seconds":
            options["max_seconds"] = float(words.pop(0))
        elif options["scene"] is None and not word.startswith("-"):
            options["scene"] = word
        else:
            refuse(f"Unknown argument {word}.")
    return options


def set_one(settings, key, value):
    if key not in KNOWN:
        refuse(f"There is no setting '{key}'; did you mean 'image_s'?")
    settings[key] = type(KNOWN[key])(value)


def spin(seconds):
    time.sleep(seconds)


def misbehave(how, start_s):
    if how == "die":
        print("Segmentation fault in the gather kernel.", file=sys.stderr, flush=True)
        os._exit(1)
    if how == "garbage":
        print("Rendering is going well so far", flush=True)
    if how == "nested":
        print("[" * 100_000, flush=True)
    if how == "number":
        print("42", flush=True)
    if how == "hang":
        time.sleep(3600)
    if how == "stop":
        sys.exit(0)
    if how == "backwards":
        return now_s() + 1.0, start_s
    if how == "other_clock":
        return start_s - 5000.0, start_s - 4999.0
    return None


def render(image, settings):
    start_s = now_s()
    how = settings["misbehave"] if image == settings["misbehave_at"] else ""
    spin(settings["image_s"] * settings["direct"])
    middle_s = now_s()
    spin(settings["image_s"] * (1 - settings["direct"]))
    end_s = now_s()
    times = misbehave(how, start_s)
    if times:
        start_s, end_s = times
        middle_s = start_s
    tell(event="stage", image=image, name="direct", start_s=start_s, end_s=middle_s, cpu_s=0.001, rays=100)
    tell(event="stage", image=image, name="indirect", start_s=middle_s, end_s=end_s, cpu_s=0.003, rays=301)
    flicker = image if how == "flicker" else 0
    pixels = hashlib.sha256(f"{settings['seed']} {flicker}".encode()).hexdigest()
    tell(event="image", image=image, start_s=start_s, end_s=end_s, time_s=max(0.0, end_s - start_s), cpu_s=0.004,
         width=8, height=8, pixel_sha256=pixels, photons={"global_stored": 10})  # fmt: skip


def write_picture(options):
    if options["output"]:
        with open(options["output"], "wb") as file:
            file.write(b"v/1\x01 picture of seed %d" % options["settings"]["seed"])


def loop(words):
    options = parse(words)
    settings = options["settings"]
    if settings["misbehave"] == "hang_at_once":
        time.sleep(3600)

    def end(*_):
        if settings["write"] == "end":
            write_picture(options)
        os._exit(0)

    signal.signal(signal.SIGTERM, signal.SIG_IGN if settings["misbehave"] == "ignore_term" else end)
    print("compiling kernels", file=sys.stderr, flush=True)
    tell(event="ready", protocol=1, scene=os.path.basename(options["scene"]), scene_sha256="ab" * 32,
         settings=settings, setup={"load_s": 0, "bvh_s": 0, "compile_s": 0}, time_s=now_s(),
         build={"name": "fake-render", "version": "9.9", "intersector": "none", "isa": "x86-64-v3", "threads": 1},
         plan={"run": ["direct", "indirect"], "left_out": {"caustics": "no specular surface"}})  # fmt: skip

    image, began_s = 0, now_s()
    while options["max_images"] is None or image < options["max_images"]:
        if image and options["max_seconds"] is not None and now_s() - began_s >= options["max_seconds"]:
            break
        render(image, settings)
        image += 1
        if settings["gap_s"]:
            spin(settings["gap_s"])
    write_picture(options)
    tell(event="done", images=image, image_file=options["output"], end_s=now_s())


def jobs():
    tell(event="waiting", protocol=1)
    while line := sys.stdin.readline():
        loop(json.loads(line))
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        tell(event="waiting", protocol=1)


if __name__ == "__main__":
    if sys.argv[1:2] == ["loop"]:
        loop(sys.argv[2:])
    elif sys.argv[1:2] == ["jobs"] and os.environ.get("FAKE_ALONE") != "1":
        jobs()
    elif sys.argv[1:2] == ["schema"]:
        print(json.dumps(SCHEMA))
    elif sys.argv[1:2] == ["--version"]:
        print("fake-render 9.9")
    else:
        refuse(f"Unknown command {sys.argv[1:]}.")
