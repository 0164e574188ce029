"""The false-alarm rate of a diagnosis, measured on records that its model draws."""
