"""The hand-held ball: its pose in the camera's frame, by a particle filter on coloured discs (Grzonka 2005)."""
