"""From points and colours to places and foods: dishes, supports, and one mask per food."""
