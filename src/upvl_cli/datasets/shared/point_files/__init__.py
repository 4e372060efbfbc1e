"""Files of points, one sweep each, recognised by what they hold: raw floats, PCD, PLY, npy and npz."""
