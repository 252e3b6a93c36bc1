//! Where the paper is ambiguous or contradicts itself, and what facewire chose.

use maud::{Markup, html};

use crate::output::Table;

/// Is followed by what was measured.
const SMOOTHING: &str = "Both are measured at 30 frames a second, within clips: figure 9. The value with N = 5 minus that with N = 10, as mean and standard deviation over clips: ";

const CHOICES: [[&str; 3]; 24] = [
    [
        "Eq. 3",
        "R1, R2 and R3 are described by a figure alone, and no point is named.",
        "R1 moves the origin between the eyes and scales by their distance, R2 turns the eyes onto x, R3 turns the nose into the plane of the screen. facewire fits all three in one step to 32 points that expressions hardly move.",
    ],
    [
        "Eq. 4",
        "\"Top 2 percentile of keypoints\": of points or of coordinates, and by which correlation?",
        "2 % of all coordinates and distances by the absolute Pearson correlation; on a board D is a list of indices.",
    ],
    [
        "Segmentation",
        "F-regression of a single feature has the same order as the correlation, so it cannot check it.",
        "The partial F, which holds the person, the pose and all other blendshapes.",
    ],
    [
        "Eq. 5",
        "Displacements, aspect ratios and principal components are all called the transformation, and so are anchor points that are not named.",
        "Displacements and 35 distances. The table above compares all of them.",
    ],
    [
        "Eq. 6",
        "epsilon = T_d(Y - m x) transforms residuals, the text \"the distribution of dependent variables\".",
        "The truth is transformed: by the square root or the logit, where that helps.",
    ],
    [
        "Exponential",
        "\"Multiple exponential\" and \"log-exponential\" have no equation.",
        "exp(w f + b) - c, of the features or of their signed logarithms.",
    ],
    [
        "CheekPuff",
        "Figure 5 gives the linear model an MSE of 0.0163 and DW 0.656; table 1 gives 0.0120 and 0.5719. Log-exponential is in the figure alone.",
        "Both are quoted; ours are from one fit.",
    ],
    [
        "Durbin-Watson",
        "It is said to detect heteroskedasticity. It detects correlated neighbours, and the order of the residuals is not stated.",
        "Residuals in the order of the estimates; Breusch-Pagan tests the spread.",
    ],
    [
        "Memory",
        "1553 bytes for a linear model and 2.9 MB for a Gaussian process are sizes of Python objects.",
        "4 bytes for each stored number and 2 for each index.",
    ],
    [
        "Eq. 7",
        "g, eta and gamma have no equation and no value; gamma is \"time weighted\", yet never changes.",
        "g rises from 0 to 1 without a kink between two values; 1/eta and gamma are constants of each blendshape, fitted to people whom the regression did not see.",
    ],
    [
        "Eq. 8: sign",
        "beta = f_t is added to w f + b, which doubles every expression that lasts longer than 1/k.",
        "A calibrated rest is subtracted, and 1 stays 1. Figure 8 shows the printed form and the other reading, a baseline.",
    ],
    [
        "Eq. 8: minimum",
        "\"The previous minimum\": of all time, or the last local one? With the last local one and noise, the condition never holds.",
        "The least value so far.",
    ],
    [
        "Eq. 8: names",
        "beta_{t,0}, B_t and F_t stand for beta_t and f_t; k has no value or unit.",
        "k = 2/s in figure 8.",
    ],
    ["Eq. 10", "It is called a variance and has the root of a standard deviation.", "A standard deviation."],
    [
        "Eq. 11: f_{t-i}",
        "The numerator has f_{t-i}, a past state, with a free index.",
        "The new value: (f_t + N avg) / (N + 1).",
    ],
    [
        "Eq. 11: gate",
        "All three cases include the edges, and on a still face the gate closes, so that noise passes.",
        "The edge is inside. The setting gated-as-printed runs it so; gated-average has a least width and no step at its edge, and is the default.",
    ],
    ["Eq. 11: states", "Are the N previous states raw or smoothed?", "Smoothed: f_t on the left replaces the state."],
    [
        "Smoothing",
        "N = 5 is said to have a higher autocorrelation than N = 10, although a longer average usually has more. The frame rate of the 59 ms is not stated.",
        SMOOTHING,
    ],
    [
        "Eq. 13, 14",
        "n_FN is defined twice, and n_algo is \"the number of correct decisions\", which would make every precision 1.",
        "The first is n_FP = n_algo - n_TP, and n_algo counts the events of the algorithm.",
    ],
    [
        "True positives",
        "delta is summed over frames, but events are counted, and a curve that is stuck high would find all.",
        "An event is a rise to f_min, and each rise finds one event.",
    ],
    [
        "Table 2",
        "The average MSD is printed as 0.019; that of its rows is 0.026. The average F1 is 0.83, but P = 0.82 and R = 0.90 give 0.86.",
        "Both are quoted as printed; ours are means of rows.",
    ],
    ["JawOpen", "Its MSD against ARKit is 0.007 in the text and 0.001 in table 2.", "Both are quoted."],
    [
        "Accuracy, deviation",
        "Neither is defined.",
        "Accuracy is 1 - sqrt(MSD), which all fifteen rows agree with; deviation is the standard deviation of the differences.",
    ],
    [
        "Response time",
        "0.86 and 2.46 ms cannot include the landmark network.",
        "The solver's time is shown without it, and that of the landmarks beside it.",
    ],
];

/// The table of choices. `excess` is by how much the autocorrelation with 5 states exceeds that with 10.
pub fn section(excess: &str) -> Markup {
    let full = |cell: &str| if cell == SMOOTHING { format!("{cell}{excess}.") } else { cell.to_owned() };
    let rows = CHOICES.map(|row| row.map(full).to_vec());
    html! {
        div.wrapped { (Table::new(["where", "what the paper says", "what was chosen"], rows).html()) }
        p { "Letters of sub-figures are the paper's, which skips (d) to (f) in figure 6 and has (d) twice in figure 8. MetaHumans are not used, because their terms forbid training." }
    }
}
