"""A client of FicTrac, which also reads spheremouse: `spheremouse run ... --output udp:127.0.0.1:2000,format=fictrac`.

It prints frame, heading and speed. It reads columns 1, 17, 19 and 22 of FicTrac's `doc/data_header.txt`.
"""

import socket
import sys

with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
    receiver.bind(("127.0.0.1", int(sys.argv[1]) if len(sys.argv) > 1 else 2000))
    while True:
        for line in receiver.recv(65536).decode().splitlines():
            column = line.split(", ")  # column 0 is the prefix FT
            print(
                f"frame {column[1]}: heading {column[17]} rad, speed {column[19]} rad a frame, {column[22]} ms",
                flush=True,
            )
