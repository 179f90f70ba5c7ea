"""Training data: from data.yaml to augmented batches."""
