"""Polynomial models A y = sum (B_i/F_i) u_i + (C/D) e: orders, criterion, starts, estimates."""
