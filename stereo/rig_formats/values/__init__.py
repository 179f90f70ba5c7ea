"""Values of calibrations: their containers, their names, and the files that complete them."""
