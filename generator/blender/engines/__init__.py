"""What renders a picture: Cycles' two engines and the surfel engine, and the reading that they share."""
