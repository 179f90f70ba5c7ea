"""Entry point of `track-range` and of `python -m track_range`."""

import gc
import os
import sys

# allocations between garbage collections; the default, 700, costs a tenth of `--help`'s time
_GC_THRESHOLD = 50_000


def main() -> None:
    """Run the command line; Ctrl-C while the libraries are loaded is reported in one sentence
    too.
    """
    gc.set_threshold(_GC_THRESHOLD)
    # before NumPy is imported: the matrices are small, and on busy cores the threads of OpenBLAS
    # wait for one another
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        from track_range.cli.app import main as command_line

        command_line()
    except KeyboardInterrupt:
        sys.stderr.write("track-range: stopped by the user.\n")
        raise SystemExit(1) from None


if __name__ == "__main__":
    main()
