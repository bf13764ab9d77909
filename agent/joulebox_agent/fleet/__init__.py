"""The daemon: leases from a server, results spooled until they are delivered."""
