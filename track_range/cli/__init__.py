"""The command line: the application, its help pages and its output; the commands are in
`commands`.
"""
