// The vendored libraries, as far as the panel uses them.
declare const mqtt: any;
declare const uPlot: any;
