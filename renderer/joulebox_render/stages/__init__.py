"""The stages of photon mapping, each a few verbs over arrays; the integrator calls them in order."""
