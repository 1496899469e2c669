"""What a run or a reward is worth: measures, figures and the report."""
