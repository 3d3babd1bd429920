"""Days: closed and open days, what they come to, their kept sums, feedback, overview and adequacy of a study."""
