"""Reports of the calibrations: figures as JSON, tables on the terminal, and one HTML page with pictures."""
