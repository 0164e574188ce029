"""Records without a hidden effect: how often does the diagnosis raise an alarm?"""
