//! A short run of the screen error: the real one has 50 poses.

use lab::lod::{screen, screen_error};
use terrain::Land;

#[test]
fn the_selection_keeps_its_tolerance_and_a_coarser_one_does_not() {
    let land = Land::new(1);
    // Tolerances of 2 and 4 px: few chunks, so that an unoptimised build is done in seconds.
    let cases: Vec<_> =
        screen::view_cases(&land, 8, 5).into_iter().filter(|case| case.tolerance_px >= 2.0).take(2).collect();
    let screen = screen_error(&land, &cases);
    assert_eq!(screen.poses, 2);
    assert!(screen.max <= 1.0, "{screen:?}");
    assert!(screen.vertices > 1_000_000 && screen.max > 0.1, "{screen:?}");
    assert!(screen.max_when_loose > 1.0, "{screen:?}");
}
