"""Does a back end or a data set keep the rules its seam asks for?"""
