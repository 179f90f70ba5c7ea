"""The HTML report, tables and figures."""
