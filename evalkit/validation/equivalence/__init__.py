"""Are two implementations of one method equivalent, and where do they first differ?"""
