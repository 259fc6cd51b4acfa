"""Import logs of a thrust stand as records: tables of any form, units, clocks, and the map from ESC signal to speed."""
