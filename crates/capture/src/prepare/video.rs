//! Frames of a video: the sharpest of each window.
//!
//! In: the sharpness of each frame, and a number of views. Out: indices of frames, in order.
//! Degenerate: a video with no more frames than views gives them all.

/// Returns the index of the sharpest frame in each of `views` windows of equal length; of equals,
/// the first.
///
/// ```
/// use luxel_capture::prepare::sharpest_frames;
///
/// assert_eq!(sharpest_frames(&[0.1, 0.9, 0.2, 0.5, 0.4, 0.3], 2), [1, 3]);
/// ```
pub fn sharpest_frames(sharpness: &[f32], views: usize) -> Vec<usize> {
    let windows = views.min(sharpness.len());
    let begin = |window: usize| window * sharpness.len() / windows.max(1);
    let sharpest = |window: usize| {
        let frames = begin(window)..begin(window + 1);
        frames.reduce(|best, frame| if sharpness.get(frame) > sharpness.get(best) { frame } else { best })
    };
    (0..windows).filter_map(sharpest).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_cover_the_video_and_have_a_frame_each() {
        let sharpness: Vec<f32> = (0..101u16).map(|i| f32::from(i * 37 % 101)).collect();
        let chosen = sharpest_frames(&sharpness, 7);
        assert_eq!(chosen.len(), 7);
        assert!(chosen.windows(2).all(|pair| pair[0] < pair[1]));
        for (window, frame) in chosen.iter().enumerate() {
            let frames = window * 101 / 7..(window + 1) * 101 / 7;
            assert!(frames.contains(frame) && frames.clone().all(|other| sharpness[other] <= sharpness[*frame]));
        }
        assert_eq!(sharpest_frames(&[0.5; 3], 9), [0, 1, 2]);
        assert!(sharpest_frames(&[], 9).is_empty());
    }
}
