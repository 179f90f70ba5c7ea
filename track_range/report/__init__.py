"""The HTML report of runs, the tables of commands, and charts."""
