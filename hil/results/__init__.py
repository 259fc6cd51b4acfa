"""What a run or a campaign leaves in its folder."""
