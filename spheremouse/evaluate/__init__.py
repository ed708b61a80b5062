"""How well a run did: what the tracker said against what was true. Arrays in, numbers out."""
