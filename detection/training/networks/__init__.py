"""Networks that can be trained, and their anchors, weights and export."""
