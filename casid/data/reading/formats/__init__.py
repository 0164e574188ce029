"""Formats of files, a module each: text, Excel, Parquet, MATLAB, HDF5, NumPy, TDMS, MDF, ROS."""
