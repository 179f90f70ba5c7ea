"""Networks as ranging methods and matchers, on real data."""
