"""A load that is put aboard a ship under way is noticed within minutes, from waves and rudder."""
