"""What a null space says: groups, fixing sets, directions and families of parameters."""
