"""Of which discs and how many a layout is made, and when its views are told apart."""

FEWEST, MOST = 4, 120  # discs
CLEAR = 3.0  # contradictions: one disc hidden and one look-alike leave more than nothing
ENOUGH = 4  # discs in view: three fix an attitude, the fourth confirms it
RADIUS, DISC_RADIUS = 0.6, 0.02  # m, where nothing else is said
