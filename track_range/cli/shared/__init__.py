"""What commands share: their parameters, groups with help pages, and output to the terminal."""
