"""A fleet of simulated ships: false discoveries, power, onsets and cost over many voyages."""
