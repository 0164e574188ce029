"""The static examples of Linder (2017), chapter 3 and Example 4.2."""
