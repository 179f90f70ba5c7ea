"""The camera and road users in the world: speeds, poses, headings, states of motion, and parallax
of static objects.
"""
