"""Liquids in mugs, cups, glasses and bowls: rim and surface are circles, the inside lies between them and the floor."""
