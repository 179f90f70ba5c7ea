"""Labelled images: from data.yaml to augmented batches."""
