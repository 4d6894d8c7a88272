"""What a picture becomes before it is learned from: sensor, features, tables of features."""
