"""Events of a drive: warnings, close following, hard approach, cut-ins and near misses."""
