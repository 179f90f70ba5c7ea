"""Options of a run: their fields, the rules between them, and notes on them."""
