"""How long a window has to be so that what a source cannot resolve stays within a wanted share."""

import math

from joulebox_agent.estimates.estimate import t_quantile

PILOT_WINDOWS = 5
ADVISED_REFRESHES = 15  # of a gauge in a window


def window_s_for_share(
    share: float, power_w: float | None, refresh_s: float | None, step_j: float | None
) -> float | None:
    """Shortest window [s] whose joules a pilot of five windows tells within `share`, as far as the source goes.

    power_w    drawn meanwhile [W]
    refresh_s  time between updates [s]; a window holds 15 of them
    step_j     step of a counter [J]. A difference of two readings is off by the difference of two uniform
               errors, standard deviation step / sqrt(6); over five windows Student's t makes of it a
               half-width of t step / sqrt(30), which must not exceed share x power x window.
    None when neither is known. What the load itself varies comes on top: that is what the pilot measures.
    """
    needs_s = [] if refresh_s is None else [ADVISED_REFRESHES * refresh_s]
    if step_j is not None and power_w:
        needs_s.append(t_quantile(PILOT_WINDOWS - 1) * step_j / math.sqrt(6 * PILOT_WINDOWS) / (share * power_w))
    elif step_j is not None:
        return None
    return max(needs_s, default=None)
