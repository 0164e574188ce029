"""Records with a hidden effect: is the first cause named the one that was hidden?"""
