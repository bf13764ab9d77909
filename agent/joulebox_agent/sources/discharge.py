"""From successive looks at the packs' counters to joules used: arithmetic alone.

Never the difference of charge x voltage: 50 mV of sag would add 850 J to a true 571 J.
"""

from joulebox_agent.sources.packs import HIGHEST_W, JOULES_PER_WH, Pack

LARGEST_STEP_J = 3600.0  # 1 % of a large pack: more than this in one step must have taken its time


class Discharge:
    """Turns successive looks at the packs into joules used since the first look.

    used_j  None until a counter was seen
    epoch   grows when the set of counting packs changes, or a counter rises (a charge, or nonsense) or falls
            faster than any machine draws
    """

    def __init__(self) -> None:
        self.used_j: float | None = None
        self.epoch = 0
        self._last: dict[str, tuple[str, float]] = {}
        self._moved_s: dict[str, float] = {}
        self._voltages: dict[str, list[float]] = {}

    def update(self, packs: tuple[Pack, ...], now_s: float) -> None:
        """Adds what was used since the previous look."""
        counts = {pack.name: count for pack in packs if (count := pack.count()) is not None}
        if not counts:
            self.used_j, self._last = None, {}
            return
        if {name: kind for name, (kind, _) in counts.items()} != {n: k for n, (k, _) in self._last.items()}:
            self.epoch += 1 if self._last else 0
            self._last, self._voltages = counts, {}
            self._moved_s = dict.fromkeys(counts, now_s)
        self.used_j = self.used_j or 0.0
        for pack in packs:
            if pack.name in counts:
                self._add(pack, counts[pack.name], now_s)
        self._last = counts

    def _add(self, pack: Pack, count: tuple[str, float], now_s: float) -> None:
        kind, now = count
        step = self._last[pack.name][1] - now
        voltages = self._voltages.setdefault(pack.name, [])
        if pack.voltage_v is not None:
            voltages.append(pack.voltage_v)
        if step == 0.0:
            return
        wh = step if kind == "energy" else step * sum(voltages) / len(voltages)
        most_j = LARGEST_STEP_J + HIGHEST_W * (now_s - self._moved_s[pack.name])
        if 0.0 < wh * JOULES_PER_WH <= most_j:
            self.used_j = (self.used_j or 0.0) + wh * JOULES_PER_WH
        else:
            self.epoch += 1
        self._moved_s[pack.name] = now_s
        self._voltages[pack.name] = voltages[-1:]


def counter_fault(packs: tuple[Pack, ...]) -> str | None:
    """A fault of a counter's file, None when every counter could be read."""
    names = ("energy_now", "charge_now")
    return next((pack.faults[name] for pack in packs for name in names if name in pack.faults), None)
