"""What in a frame is the athlete: stage 5. `foreground` leads; `colours` says what a pixel's colours speak for,
`outline` draws where the body ends."""
