"""Reports: pages of their own, with figures and tables beside them, that need no server and no network."""
