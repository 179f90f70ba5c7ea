"""Labels of annotation tools and data sets in JSON, XML and CSV: a table of the names that each uses,
and one reader.
"""
