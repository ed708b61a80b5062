"""The wand's tracker as published by Grzonka 2005: a bootstrap particle filter with the product likelihood."""
