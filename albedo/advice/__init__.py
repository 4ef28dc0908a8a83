"""The cheapest way to what a scene needs: candidates, what they cost, and what they err by."""
