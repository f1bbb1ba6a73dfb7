//! A short run of the screen error: the real one has 50 poses.

use lab::lod::{screen, screen_error};
use terrain::Land;

#[test]
fn what_is_drawn_keeps_the_tolerance_and_what_is_chosen_for_four_of_them_does_not() {
    let land = Land::new(1);
    // Tolerances of 2 and 4 px: few chunks, so that an unoptimised build is done in seconds.
    let places: Vec<_> =
        screen::places(&land, 8, 5).into_iter().filter(|place| place.tolerance_px >= 2.0).take(2).collect();
    let screen = screen_error(&land, &places);
    assert_eq!(screen.poses, 2);
    assert!(screen.max <= 1.0, "{screen:?}");
    assert!(screen.vertices > 1_000_000 && screen.max > 0.1, "{screen:?}");
    assert!(screen.max_when_loose > 1.0, "{screen:?}");
}
