"""Energy sources: one file each, all behind `reading.EnergySource`.

A new platform is a new file here with a class of that interface, plus one line in `choose.SOURCES`;
nothing else in the agent knows where joules come from.
"""
