use facewire_fit::drawing::*;

#[test]
fn the_persons_left_is_drawn_at_the_right_and_up_is_up() {
    let drawing = face(&[[1.0, 1.0], [-1.0, -1.0]], &[0.0, 1.0], &[]).unwrap();
    let attribute = |mark: &str| -> Vec<i32> {
        drawing.split(mark).skip(1).map(|rest| rest.split('"').next().unwrap().parse().unwrap()).collect()
    };
    let (x, y) = (attribute(" cx=\""), attribute(" cy=\""));
    assert!(x[0] > x[1] && y[0] < y[1], "{x:?} {y:?}");
}
