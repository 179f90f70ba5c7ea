"""Options of the detector and of the tracker that commands share."""
