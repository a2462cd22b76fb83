"""Routes of the daemon by subject, for the Unix socket and the network."""
