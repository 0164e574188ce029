"""Whether the intervals of `identify` hold the truth as often as they say."""
