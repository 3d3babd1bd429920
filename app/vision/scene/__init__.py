"""From points and colours to places and foods: dishes, vessels with what they hold, supports, one mask per food."""
