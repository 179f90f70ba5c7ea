"""Export of finished runs and of label files to other formats."""
