"""The live page: a process of its own between the daemon and browsers."""
