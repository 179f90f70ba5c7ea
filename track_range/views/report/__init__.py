"""The HTML report of runs, the tables of commands, and charts."""

from track_range.foundation.files.cache_folder import set_matplotlib_folder

set_matplotlib_folder()  # before a module of this package imports matplotlib
