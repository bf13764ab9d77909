"""The documents that cross the network, as frozen models that refuse unknown fields and NaN."""
