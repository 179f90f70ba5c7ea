"""Networks that can be trained, their anchors, weights and export."""
