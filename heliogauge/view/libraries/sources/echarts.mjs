// What maps, charts and photos use of Apache ECharts.
import { BarChart, CustomChart, LineChart, ScatterChart } from "echarts/charts";
import { DataZoomInsideComponent, GridComponent, LegendScrollComponent, TooltipComponent } from "echarts/components";
import { use } from "echarts/core";
import { CanvasRenderer } from "echarts/renderers";

use([
  LineChart, BarChart, ScatterChart, CustomChart,
  GridComponent, TooltipComponent, LegendScrollComponent, DataZoomInsideComponent, CanvasRenderer,
]);
export { getInstanceByDom, graphic, init, version } from "echarts/core";
