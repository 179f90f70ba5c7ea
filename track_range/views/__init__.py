"""Views of results: overlay, event clips, report, live view, anonymization, and the writer of
videos.
"""
