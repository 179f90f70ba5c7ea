"""What all recordings share: frames, names, dates, and the numbers of threads that read them."""
