"""The service: a camera watched for months, motion sent, questions answered. Threads, clocks and sockets live here."""
